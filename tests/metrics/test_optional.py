from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from cases import case
from numpy.typing import NDArray

from nrbench.metrics import perceptual, portilla
from nrbench.metrics.perceptual import Perceptual
from nrbench.metrics.portilla import Portilla, departure, usual_departure


def moments(plane: NDArray[np.float32]) -> NDArray[np.float64]:
    """Replace the package's statistics."""
    return np.array([plane.mean(), plane.std(), np.abs(np.diff(plane)).mean()], np.float64)


@pytest.fixture
def present(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the packages seem to be installed."""
    monkeypatch.setattr(portilla, "find_spec", lambda name: object())
    monkeypatch.setattr(portilla, "statistics", moments)
    monkeypatch.setattr(perceptual, "find_spec", lambda name: object())


@pytest.mark.parametrize(
    ("module", "metric", "column"), [(portilla, Portilla, "distance"), (perceptual, Perceptual, "dists")]
)
def test_absent_packages_are_named(
    monkeypatch: pytest.MonkeyPatch,
    module: object,
    metric: type[Portilla] | type[Perceptual],
    column: str,
) -> None:
    """Without the package the column is None, and the reason names what to install."""
    monkeypatch.setattr(module, "find_spec", lambda name: None)
    score = metric().score(case("brick").observe(case("brick").fresh()))
    assert score.values == {column: None}
    assert "pip install 'nrbench[perceptual]'" in score.reasons[column]


def test_statistics_are_compared_with_fresh_draws(present: None) -> None:
    """A fresh draw has a small distance, a blurred one a larger one."""
    found = [
        Portilla().score(case("brick").observe(image)).values["distance"]
        for image in (case("brick").fresh(), case("brick").planted("blurred-band", 0.3)[0])
    ]
    assert found[0] < 2.5 < found[1]


def test_missing_scores_have_reasons(present: None) -> None:
    """Photographs, small outputs and textures without further draws have no distance."""
    photograph = Portilla().score(case("brick").observe(case("brick").fresh(), model=False))
    assert photograph.reasons["distance"].startswith("not applicable")
    small = Portilla().score(case("brick").observe(case("brick").fresh()[:100]))
    assert small.reasons["distance"].startswith("undecided")
    observation = case("brick").observe(case("brick").fresh())
    ended = Portilla().score(replace(observation, again=lambda shape, k: None))
    assert ended.reasons["distance"].startswith("not applicable")


def test_departures_are_z_scores() -> None:
    """Statistics two standard deviations off have a departure of 2, and draws one of 1 from each other."""
    draws = np.random.default_rng(0).normal(5, 1, (40, 300))
    assert departure(draws.mean(0) + 2 * draws.std(0, ddof=1), draws) == pytest.approx(2, rel=0.03)
    assert usual_departure(draws) == pytest.approx(1, abs=0.1)


def test_absent_weights_are_named(present: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Without the weights nothing is downloaded, and the reason names the files."""
    monkeypatch.setattr(perceptual, "torch", SimpleNamespace(hub=SimpleNamespace(get_dir=lambda: str(tmp_path))))
    score = Perceptual().score(case("brick").observe(case("brick").fresh()))
    assert score.values == {"dists": None}
    assert "dists_weights.pt" in score.reasons["dists"] and str(tmp_path) in score.reasons["dists"]


def test_the_network_gets_the_pixels(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The network gets the images' own values, and the score is the ratio of its distances."""
    (tmp_path / "checkpoints").mkdir()
    for name in perceptual.WEIGHTS:
        (tmp_path / "checkpoints" / name).touch()
    shown: list[NDArray[np.float32]] = []

    def network(one: NDArray[np.float32], other: NDArray[np.float32]) -> float:
        shown.append(one)
        return 0.6 if len(shown) <= 3 else 0.2

    hub = SimpleNamespace(get_dir=lambda: str(tmp_path))
    fake = SimpleNamespace(hub=hub, no_grad=nullcontext, from_numpy=lambda array: array)
    monkeypatch.setattr(perceptual, "find_spec", lambda name: object())
    monkeypatch.setattr(perceptual, "torch", fake)
    monkeypatch.setattr(perceptual, "piq", SimpleNamespace(DISTS=lambda: network))
    output = case("brick").fresh()
    score = Perceptual().score(case("brick").observe(output))
    assert score.values["dists"] == pytest.approx(3)
    assert len(shown) == 6
    assert (shown[0] == np.moveaxis(output, -1, 0)[np.newaxis]).all()
