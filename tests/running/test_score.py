from typing import Any

import numpy as np
import pytest

import nrbench
from nrbench import plugins
from nrbench.plugins.forms import Observation, Score


class Broken:
    """A metric that raises."""

    columns = {"value": None}

    def score(self, observation: Observation) -> Score:
        """Raise."""
        raise ArithmeticError("out of luck")


def pair() -> tuple[Any, Any, Any]:
    """Return a sample, an output of the same texture, and the lattice."""
    sample, output = (nrbench.texture("brick", shape=(side, side), seed=0, color=0.3) for side in (128, 160))
    return sample.image, output.image, sample.lattice


def test_a_metric_that_raises_takes_no_other_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its columns are None with the error as the reason; all others are scored."""
    build = plugins.build
    monkeypatch.setattr(
        plugins, "build", lambda kind, name, *rest: Broken() if name == "source" else build(kind, name, *rest)
    )
    sheet = nrbench.score(*pair()[:2], lattice=pair()[2])
    assert sheet.values["source.value"] is None
    assert sheet.reasons["source.value"].startswith("failed: ArithmeticError: out of luck (test_score.py, line ")
    assert sheet.values["regularity.preserved"] is True


@pytest.mark.parametrize(
    ("lattice", "reason"),
    [("2,0,0,2", "explains 0% of the sample's variance"), ("500,0,0,500", "smaller than a window of 2 tiles")],
)
def test_an_unsuitable_lattice_gives_a_reason(lattice: str, reason: str) -> None:
    """For a too fine or too coarse lattice, every column of regularity is None, and no metric fails."""
    sheet = nrbench.score(*pair()[:2], lattice=lattice)
    found = {name: sheet.reasons[name] for name, value in sheet.values.items() if name.startswith("regularity.")}
    assert all(reason in why for why in found.values())
    assert not [why for why in sheet.reasons.values() if why.startswith("failed")]


def test_what_is_not_measured_is_not_zero() -> None:
    """For a constant output, drift and single tiles cannot be measured: the columns are None, with a reason."""
    sample, output, lattice = pair()
    sheet = nrbench.score(sample, np.full_like(output, 0.5), lattice=lattice)
    assert sheet.values["regularity.preserved"] is False
    for name in ("regularity.drift", "regularity.intact", "regularity.lattice_exact"):
        assert sheet.values[name] is None
        assert sheet.reasons[name]
