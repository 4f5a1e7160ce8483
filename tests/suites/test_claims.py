"""Claims in suites: which cells they need, and what is refused."""

from typing import Any

import pytest

from nrbench.errors import BadInput
from nrbench.plugins import find
from nrbench.suites.plan import make_plan
from nrbench.suites.suite import load_suite, validated_suite

CLAIM: dict[str, Any] = {
    "name": "blocks",
    "quote": "Larger blocks reduce randomness.",
    "source": "a paper, section 5",
    "score": "randomness.variation",
    "axis": "block, px",
    "textures": ["small*"],
    "series": [{"name": "rsgf", "levels": [24, 40], "methods": ["rsgf:block=24", "rsgf"]}],
    "expect": [{"series": "rsgf", "at": 40, "relation": "less", "other_at": 24}],
}
CONTENT: dict[str, Any] = {
    "name": "tiny",
    "lattice": ["given"],
    "sample": "64x64",
    "size": "64x64",
    "texture": [{"name": name, "dataset": "hexagon"} for name in ("small-1", "small-2", "other")],
    "claim": [CLAIM],
}


def pairs(content: dict[str, Any]) -> set[tuple[str, str]]:
    """Return the textures and methods of the cells of a suite."""
    return {(cell.texture, cell.label) for cell, _ in make_plan(validated_suite(content, "tiny")).cells}


def with_claim(**changes: Any) -> dict[str, Any]:
    """Return a suite whose claim has some keys replaced."""
    return {**CONTENT, "claim": [{**CLAIM, **changes}]}


def test_a_suite_of_claims_runs_what_they_need() -> None:
    """Each method runs on the textures of the claims that name it, and on no other texture."""
    assert pairs(CONTENT) == {(texture, method) for texture in ("small-1", "small-2") for method in METHODS}


METHODS = ("rsgf:block=24", "rsgf")


def test_each_level_may_have_its_own_textures() -> None:
    """A level that names textures needs its method on these only."""
    series = {**CLAIM["series"][0], "textures": [["small-1"], ["other"]]}
    assert pairs(with_claim(series=[series])) == {("small-1", "rsgf:block=24"), ("other", "rsgf")}


def test_methods_that_no_claim_names_run_everywhere() -> None:
    """A suite may add a method, for example the oracle; the methods of claims then run only if the suite lists them."""
    content = {**CONTENT, "methods": ["oracle", "rsgf"]}
    everywhere = {(texture, "oracle") for texture in ("small-1", "small-2", "other")}
    assert pairs(content) == everywhere | {("small-1", "rsgf"), ("small-2", "rsgf")}


def test_claims_change_the_hash_only_where_they_are() -> None:
    """A suite without claims keeps its hash, and another quote is another suite."""
    plain = {key: value for key, value in CONTENT.items() if key != "claim"} | {"methods": ["rsgf"]}
    assert validated_suite(plain, "").hash == validated_suite({**plain, "claim": []}, "").hash
    assert validated_suite(CONTENT, "").hash != validated_suite(with_claim(quote="Another."), "").hash


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"quotation": "x"}, "did you mean 'quote'"),
        ({"textures": ["nothing*"]}, "no texture matches nothing*"),
        (
            {"expect": [{"series": "rsgf", "at": 41, "relation": "less", "value": 1}]},
            "no series 'rsgf' with the level 41",
        ),
        ({"expect": [{"series": "rsgf", "at": 40, "relation": "less"}]}, "give either value, or other"),
        ({"expect": [{"series": "rsgf", "at": 40, "relation": "equal", "value": 1}]}, "relation equal needs a margin"),
        ({"series": [{"name": "rsgf", "levels": [1, 2, 3], "methods": ["rsgf", "rsgf"]}]}, "2 methods for 3 levels"),
        ({"series": [{"name": "rsgf", "levels": [40, 40], "methods": ["rsgf"]}]}, "a level is given twice"),
        ({"expect": []}, "expect"),
    ],
)
def test_a_claim_that_makes_no_sense_is_refused(changes: dict[str, Any], message: str) -> None:
    """The message names the claim's key, and what is wrong with it."""
    with pytest.raises(BadInput, match="tiny") as caught:
        validated_suite(with_claim(**changes), "suite tiny")
    assert message in str(caught.value)


def test_the_scores_of_the_builtin_claims_exist() -> None:
    """Each claim of the suite ``claims`` reads a column that a metric declares."""
    for claim in load_suite("claims").claim:
        metric, _, column = claim.score.partition(".")
        assert column in find("metrics", metric).cls.columns, claim.name


def test_claims_need_one_source_of_the_lattice() -> None:
    """Means over cells of two sources would mix what methods were given with what they found."""
    with pytest.raises(BadInput, match="claims compare methods with one source of the lattice; name one of given, own"):
        validated_suite({**CONTENT, "lattice": ["given", "own"]}, "suite tiny")


def test_builtin_suites_other_than_claims_test_no_claims() -> None:
    """The suite of claims is the only one that restricts methods to textures."""
    assert not any(load_suite(name).claim for name in ("default", "core", "frontier", "report2004", "spectrum"))
