"""``nrbench check``: a plugin that violates a clause fails this clause, and no other one."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from commands import call

from nrbench import plugins
from nrbench.authoring import conformance
from nrbench.authoring.conformance import Conformance, check_plugin
from nrbench.authoring.plugin_checks import CLAUSES
from nrbench.errors import BadInput

VIOLATORS = Path(__file__).with_name("violators.py")
VIOLATIONS = {
    "synthesizers": {
        "determinism": ["determinism", "state"],
        "randomness": ["randomness", "python", "seeds"],
        "side effects": ["files", "environment", "threads"],
        "output": ["range", "shape"],
        "own lattice": ["lattice"],
        "source map": ["lie"],
        "refusals": ["refusals", "mute"],
        "progress": ["progress", "backward"],
        **{clause: [clause] for clause in ("read-only", "gray")},
    },
    "detectors": {
        "detection": ["text", "confidence"],
        **{clause: [clause] for clause in ("gray", "no guess", "odd images")},
    },
    "metrics": {
        "score": ["float", "reason", "json", "range"],
        **{clause: [clause] for clause in ("gray", "little known")},
    },
    "datasets": {
        "texture": ["shape"],
        "fresh draws": ["fresh draws", "size", "recomposition"],
        **{clause: [clause] for clause in ("read-only", "shapes", "truth")},
    },
    "reports": {
        "files": ["none", "missing"],
        **{clause: [clause] for clause in ("inside", "no results", "markup", "terminal")},
    },
}
"""What the plugins of these tests do, by the clause that forbids it."""
NAMES = {kind: f"bad{plugins.FORMS[kind].noun}" for kind in VIOLATIONS}
CASES = [
    (kind, how, clause) for kind, all_hows in VIOLATIONS.items() for clause, hows in all_hows.items() for how in hows
]


@pytest.fixture(autouse=True)
def violators() -> Iterator[None]:
    """Register the plugins that violate clauses."""
    plugins.add_file(VIOLATORS)
    yield
    plugins.registry._files.pop(VIOLATORS.resolve(), None)


@pytest.fixture(autouse=True, scope="module")
def one_run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Make the run of the reports' clauses once."""
    made = conformance.make_example_run(tmp_path_factory.mktemp("reports") / "run")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(conformance, "make_example_run", lambda root: made)
        yield


def failed(kind: str, name: str, how: str = "") -> dict[str, str]:
    """Return the reasons of the clauses that a plugin fails, checked in this process."""
    parameters = {"how": how} if how else {}
    findings = check_plugin(kind, name, parameters, here=True)
    return {finding.clause: finding.reason for finding in findings if finding.verdict == "fail"}


@pytest.mark.parametrize("kind", NAMES)
def test_a_plugin_that_behaves_passes(kind: str) -> None:
    """Without a violation the plugins of these tests fail no clause, and every clause was checked."""
    findings = list(check_plugin(kind, NAMES[kind], here=True))
    assert [finding.clause for finding in findings] == [clause.name for clause in CLAUSES[kind]]
    assert [finding for finding in findings if finding.verdict == "fail"] == []


@pytest.mark.parametrize(("kind", "how", "clause"), CASES)
def test_a_violation_fails_its_clause_alone(kind: str, how: str, clause: str) -> None:
    """Each planted violation fails the clause that forbids it, and no other one."""
    assert list(failed(kind, NAMES[kind], how)) == [clause]


@pytest.mark.parametrize(
    ("name", "clause"), [("nameless", "docstring"), ("miscited", "paper"), ("forgetful", "parameters")]
)
def test_a_page_and_parameters_are_checked(name: str, clause: str) -> None:
    """A parameter without description, a paper that is no BibTeX, a parameter that is misread: each fails."""
    assert list(failed("synthesizers", name)) == [clause]


def test_an_error_names_the_line_of_the_plugin() -> None:
    """The reason of a clause that an error ends holds the error and the line of the plugin."""
    assert "IndexError: too small (violators.py, line " in failed("synthesizers", "badmethod", "refusals")["refusals"]


def test_clauses_can_be_chosen() -> None:
    """A chosen clause is checked with those that it depends on; an unknown one names the nearest."""
    chosen = check_plugin("synthesizers", "badmethod", here=True, only=["gray"])
    assert [finding.clause for finding in chosen] == ["output", "gray"]
    with pytest.raises(BadInput, match=r"clause 'grey' of methods is not known \(did you mean 'gray'"):
        list(check_plugin("synthesizers", "badmethod", only=["grey"]))


def test_an_unknown_plugin_names_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    """A misspelt name is answered with the one that was meant; a kind leaves out the others."""
    for words, message in (
        (["badmethd"], "did you mean 'badmethod'"),
        (["badmethod", "--kind", "metrics"], "not known"),
    ):
        assert call("check", *words) == 2
        assert message in capsys.readouterr().err


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
    code, found = check("badmethod:how=slow --clause progress --clause gray --timeout 2", capsys)
    assert code == 1 and "timeout: took longer than 2 s" in found["gray"].reason
    assert found["output"].verdict == "pass"
