"""``nrbench check``: a plugin that violates a clause fails this clause, and no other one."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from commands import call
from conformance import example_run as example_run
from conformance import violations

from nrbench import plugins
from nrbench.authoring.conformance import Conformance, check_plugin
from nrbench.authoring.plugin_checks import CHECKS
from nrbench.errors import BadInput

PLUGINS = Path(__file__).with_name("bad_plugins.py")
NAMES = {kind: f"bad{plugins.FORMS[kind].noun}" for kind in CHECKS}
OF_METHODS = {"parameters", "docstring", "paper", "determinism", "processes", "randomness"}
"""Clauses that plugins of all kinds share; methods violate them in these tests."""
PLANTED = [
    (kind, clause)
    for kind, checks in CHECKS.items()
    for clause in checks
    if clause not in OF_METHODS and (clause != "read only" or kind in ("synthesizers", "datasets"))
] + [("synthesizers", clause) for clause in ("determinism", "randomness")]


@pytest.fixture(autouse=True)
def bad_plugins() -> Iterator[None]:
    """Register the plugins that violate clauses."""
    plugins.add_file(PLUGINS)
    yield
    plugins.registry._files.pop(PLUGINS.resolve(), None)


def failed(kind: str, name: str, how: str = "") -> dict[str, str]:
    """Return the reasons of the clauses that a plugin fails, checked in this process."""
    lines = [line for line in violations(kind, name, {"how": how}) if line.startswith("fail")]
    return dict(line.removeprefix("fail ").split(": ", 1) for line in lines)


@pytest.mark.parametrize("kind", NAMES)
def test_a_plugin_that_behaves_passes(kind: str, example_run: Path) -> None:
    """Without a violation the plugins of these tests fail no clause, and every clause was checked."""
    findings = list(check_plugin(kind, NAMES[kind], here=True))
    assert [finding.clause for finding in findings] == list(CHECKS[kind])
    assert [finding for finding in findings if finding.verdict == "fail"] == []


@pytest.mark.parametrize(("kind", "clause"), PLANTED)
def test_a_violation_fails_its_clause_alone(kind: str, clause: str, example_run: Path) -> None:
    """Each planted violation fails the clause that forbids it, and no other one."""
    assert list(failed(kind, NAMES[kind], clause)) == [clause]


@pytest.mark.parametrize(
    ("name", "clause"), [("nameless", "docstring"), ("miscited", "paper"), ("forgetful", "parameters")]
)
def test_a_page_and_parameters_are_checked(name: str, clause: str) -> None:
    """A parameter without description, a paper that is no BibTeX, a parameter that JSON cannot hold: each fails."""
    assert list(failed("synthesizers", name)) == [clause]


def test_an_error_names_the_line_of_the_plugin() -> None:
    """The reason of a clause that an error ends holds the error and the line of the plugin."""
    assert "IndexError: too small (bad_plugins.py, line " in failed("synthesizers", "badmethod", "refusals")["refusals"]


def test_clauses_can_be_chosen() -> None:
    """A chosen clause is checked with those that it depends on; an unknown one names the nearest."""
    for name in ("source map", "source-map"):
        chosen = check_plugin("synthesizers", "badmethod", here=True, only=[name])
        assert [finding.clause for finding in chosen] == ["output", "read only", "source map"]
    with pytest.raises(BadInput, match=r"clause 'grey' of methods is not known \(did you mean 'gray'"):
        list(check_plugin("synthesizers", "badmethod", only=["grey"]))


def check(words: str, capsys: pytest.CaptureFixture[str]) -> tuple[int, dict[str, Conformance]]:
    """Run ``nrbench check --json``; return the exit code and the findings."""
    code = call(f"check {words} --json")
    (checked,) = json.loads(capsys.readouterr().out)["plugins"]
    return code, {item["clause"]: Conformance(**item) for item in checked["clauses"]}


def test_a_crash_fails_one_clause(capsys: pytest.CaptureFixture[str]) -> None:
    """A method that ends its process fails the clause that called it; the others are checked or depend on it."""
    code, found = check("badmethod:how=crash", capsys)
    assert code == 1
    assert found["output"].verdict == "fail" and "crash: exited with code 7" in found["output"].reason
    assert [name for name, one in found.items() if one.verdict == "fail"] == ["output"]
    assert found["docstring"].verdict == "pass" and found["gray"].verdict == "skip"


def test_another_interpreter_must_give_the_same(capsys: pytest.CaptureFixture[str]) -> None:
    """An output that depends on the hash of a word fails `processes` alone; a clause that hangs fails at its limit."""
    code, found = check("badmethod:how=processes --clause processes --clause gray", capsys)
    assert (code, [name for name, one in found.items() if one.verdict == "fail"]) == (1, ["processes"])
    code, found = check("badmethod:how=hang --clause progress --clause gray --timeout 2", capsys)
    assert code == 1 and "timeout: took longer than 2 s" in found["gray"].reason
    assert found["output"].verdict == "pass"
