"""The check of ``nrbench check`` in this process, for tests of the plugins of nrbench."""

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from nrbench.authoring import conformance
from nrbench.authoring.plugin_checks import CHECKS

ALWAYS = frozenset({"processes"})
"""The clause that is left out, because it starts another interpreter."""


@pytest.fixture(scope="module")
def example_run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Make the run on which reports are tried once."""
    made = conformance.make_example_run(tmp_path_factory.mktemp("reports") / "run")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(conformance, "make_example_run", lambda root: made)
        yield made


def violations(
    kind: str,
    name: str,
    parameters: Mapping[str, Any] | None = None,
    left_out: Collection[str] = (),
    may_skip: Collection[str] = (),
) -> list[str]:
    """Return a line for each clause that a plugin fails, or that is skipped and may not be.

    Parameters
    ----------
    kind, name, parameters
        The plugin.
    left_out
        Further clauses that are not checked, to save time.
    may_skip
        Clauses that may not apply.
    """
    clauses = [clause for clause in CHECKS[kind] if clause not in {*ALWAYS, *left_out}]
    findings = conformance.check_plugin(kind, name, parameters, here=True, only=clauses)
    return [
        f"{finding.verdict} {finding.clause}: {finding.reason}"
        for finding in findings
        if finding.verdict == "fail" or (finding.verdict == "skip" and finding.clause not in {"paper", *may_skip})
    ]
