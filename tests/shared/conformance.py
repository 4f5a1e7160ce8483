"""The check of ``nrbench check`` in this process, for tests of the plugins of nrbench."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from nrbench.authoring.conformance import check_plugin
from nrbench.authoring.plugin_checks import CLAUSES

ALWAYS = frozenset({"processes"})
"""The clause that is left out, because it needs two interpreters."""


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
    clauses = [clause.name for clause in CLAUSES[kind] if clause.name not in {*ALWAYS, *left_out}]
    findings = check_plugin(kind, name, parameters, here=True, only=clauses)
    return [
        f"{finding.verdict} {finding.clause}: {finding.reason}"
        for finding in findings
        if finding.verdict == "fail" or (finding.verdict == "skip" and finding.clause not in {"paper", *may_skip})
    ]
