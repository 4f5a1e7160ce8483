"""Claims about the suites that come with the models."""

import itertools
import json
import math
import re
from collections import Counter
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from nrbench import plugins
from nrbench.datasets_procedural.modelling.model import Model
from nrbench.imaging.convert import to_bytes
from nrbench.lattice.geometry import Lattice
from nrbench.streams import pixels_hash
from nrbench.suites.plan import Sample, draw_samples
from nrbench.suites.suite import Suite, TextureRow, load_suite

SPECTRA = ("white", "pink", "brown", "blobs", "grass")
SHARES = {"mild": (0.9, 1.0), "middle": (0.6, 0.9), "strong": (0.3, 0.6), "inks": (0.5, 0.7)}
FROZEN_SUITES = ("core", "default", "integer", "spectrum", "report2004")
TILES = 12
"""Area of a sample of the report's near-regular textures, in tiles."""
FROZEN = Path(__file__).with_name("frozen_samples.json")
ROWS = [pytest.param(row, id=row.name) for row in load_suite("core").texture]


def _model(row: TextureRow) -> Model:
    model = plugins.build("datasets", row.dataset, row.parameters)
    assert isinstance(model, Model)
    return model


def _said_share(row: TextureRow) -> float:
    return float(re.findall(r"regular share (0\.\d\d)", row.description)[0])


@cache
def drawn(name: str) -> list[Sample]:
    """Draw the samples of a suite once."""
    return draw_samples(load_suite(name))


def test_families_by_shares() -> None:
    """In core each family comes at each regular share, once axis-aligned and once rotated, and once in few inks."""
    rows = load_suite("core").texture
    cells = Counter((row.family, row.name.split("-")[1]) for row in rows)
    assert set(cells) == set(itertools.product(("brick", "weave", "hexagon"), SHARES)) and len(rows) == 21
    assert all(count == (1 if strength == "inks" else 2) for (_, strength), count in cells.items())
    assert sum("rotation" in row.parameters for row in rows) == 9
    assert {row.family: row.parameters["inks"] for row in rows if "inks" in row.parameters} == {
        "brick": 3,
        "weave": 2,
        "hexagon": 4,
    }


def test_default_is_balanced() -> None:
    """In default each condition comes in each family, with one regular share, one size and one enlargement."""
    suite = load_suite("default")
    conditions: dict[str, list[TextureRow]] = {}
    for row in suite.texture:
        family, condition = row.name.split("-")
        assert row.family == row.dataset == family and row.sample is row.size is None
        conditions.setdefault(condition, []).append(row)
    assert len(conditions) == 8 and len(suite.texture) == 24 and suite.replicates == 2
    for condition, rows in conditions.items():
        assert [row.family for row in rows] == ["brick", "weave", "hexagon"]
        shares = [_model(row).regular_share for row in rows]
        assert [_said_share(row) for row in rows] == pytest.approx(shares, abs=0.0051)
        assert np.ptp(shares) < 0.01 or condition == "bent"
        assert all(_model(row).bend == (0.25 if condition == "bent" else 0) for row in rows)


def test_default_shows_enough_cells() -> None:
    """The samples of default show 25 cells or more, those of few periods 8 to 11."""
    for row in load_suite("default").texture:
        lattice = _model(row).render((16, 16), np.random.default_rng(0)).lattice
        cells = 96 * 96 / lattice.area
        assert 8 < cells < 11 if row.name.endswith("few") else cells > 25


def test_frontier_has_graded_axes() -> None:
    """Each row of frontier belongs to an axis with at least three levels; each axis has one model."""
    suite = load_suite("frontier")
    axes: dict[str, list[TextureRow]] = {}
    for row in suite.texture:
        axes.setdefault(row.departure, []).append(row)
    assert len(axes) == 10 and "" not in axes
    for rows in axes.values():
        levels = [row.level for row in rows]
        assert len(rows) >= 3 and None not in levels and len(set(levels)) == len(levels)
        assert len({row.dataset for row in rows}) == 1
    by_name = {name: {row.level: row for row in rows} for name, rows in axes.items()}
    for level, row in by_name["periods in the sample"].items():
        assert row.sample and row.size and row.size[0] == 4 * row.sample[0]
        assert row.sample[0] / _model(row).s == pytest.approx(level, abs=0.05)
    for level, row in by_name["output size"].items():
        assert row.sample and row.size and row.size[0] == level * row.sample[0]
    for level, row in by_name["regular share"].items():
        assert _model(row).regular_share == pytest.approx(level, abs=0.0051)
    for level, row in by_name["period"].items():
        assert _model(row).s == pytest.approx(level, abs=0.5)
    for departure in ("bend", "jitter", "light"):
        assert all(getattr(_model(row), departure) == level for level, row in by_name[departure].items())


@pytest.mark.parametrize("row", [*ROWS, *(pytest.param(row, id=row.name) for row in load_suite("integer").texture)])
def test_share_is_what_the_row_says(row: TextureRow) -> None:
    """The regular share lies in the range that the name tells, and is the one in the description."""
    share = _model(row).regular_share
    low, high = SHARES[row.name.split("-")[1]]
    assert low <= share < high
    assert _said_share(row) == pytest.approx(share, abs=0.0051)


@pytest.mark.parametrize("row", ROWS)
def test_periods_are_not_lucky(row: TextureRow) -> None:
    """4 to 7 periods fit a side of the sample; none is whole, or commensurate with the sample or a block of 40 px."""
    lattice = _model(row).render((32, 32), np.random.default_rng(0)).lattice
    reduced = lattice.reduced()
    assert 4 <= 128 / reduced.s <= 7
    corners = np.array([(1, 0), (0, 1), (1, 1), (1, -1), (2, 1), (1, 2), (2, -1), (1, -2)]) @ reduced.matrix
    for whole in (1, 40, 128):
        aligned = [v for v in corners if np.abs(v).min() < 1e-9]
        turns = np.array([np.abs(v).max() for v in aligned])
        counts = turns if whole == 1 else whole / turns
        assert (np.abs(counts - np.rint(counts)) > 0.05).all()
    assert bool(aligned) != ("rotation" in row.parameters)


@pytest.mark.parametrize("row", load_suite("integer").texture, ids=lambda row: row.name)
def test_integer_is_lucky(row: TextureRow) -> None:
    """Each vector of the twin is whole (of hexagons, within 0.03 px); upright ones fit the sample."""
    model, twin = _model(row), _model(next(each for each in load_suite("core").texture if each.name == row.name))
    lattice = model.render((16, 16), np.random.default_rng(0)).lattice
    assert lattice is not None and type(model) is type(twin) and bool(model.rotation) == bool(twin.rotation)
    assert np.abs(lattice.matrix - np.rint(lattice.matrix)).max() < (0.03 if row.family == "hexagon" else 1e-9)
    assert model.regular_share == pytest.approx(twin.regular_share, abs=0.02)
    if row.family != "hexagon" and not model.rotation:
        steps = np.array([(128.0, 0.0), (0.0, 128.0)]) @ np.linalg.inv(lattice.matrix)
        np.testing.assert_allclose(steps, np.rint(steps), atol=1e-9)


def test_spectrum_is_graded() -> None:
    """The knob goes from perfectly regular to no lattice in at least 8 steps, each less regular than the last."""
    samples = drawn("spectrum")
    textures = [sample.texture for sample in samples if sample.texture is not None]
    shares = [texture.regular_share for texture in textures]
    assert len(textures) == len(samples) >= 8 and shares[0] == 1.0 and shares == sorted(shares, reverse=True)
    assert textures[0].kind == "0" and {texture.kind for texture in textures[1:-1]} == {"III"}
    assert textures[-1].kind == "stochastic" and textures[-1].lattice is None
    for sample in samples:
        assert f"{sample.texture.regular_share:.2f}" in sample.row.description or sample.row.dataset == "noise"


def test_report_rows() -> None:
    """Each of figures 3 to 45 has a row: 3 to 7 are exact, the others nearly regular in places and colors."""
    rows = {sample.row.figure: sample for sample in drawn("report2004") if sample.row.figure}
    assert sorted(rows) == [*range(3, 46)] and len(drawn("report2004")) == 47
    kinds = [rows[figure].texture.kind for figure in sorted(rows)]
    assert kinds == ["0"] * 5 + ["III"] * 38
    others = [sample.texture.kind for sample in drawn("report2004") if not sample.row.figure and sample.texture]
    assert others == ["II", "II", "III", "III"]
    for sample in rows.values():
        description, colon, hard = sample.row.description.partition(": ")
        assert colon and len(hard) > 20 and description.replace(" ", "-").replace("&", "-") in sample.row.name


def test_report_doses() -> None:
    """The name of the object decides the dose, a sample has the area of 12 tiles, an output is twice as wide."""
    doses: dict[str, tuple[float, float]] = {}
    for row in load_suite("report2004").texture:
        if row.figure and row.figure > 7:
            dose = row.parameters.get("bend", 0.0), row.parameters.get("jitter", 0.0)
            assert doses.setdefault(row.description.partition(":")[0], dose) == dose
            lattice = Lattice(*_model(row).vectors).reduced()
            side = max(72, round(math.sqrt(TILES * lattice.area)), math.ceil(2.2 * np.hypot(*lattice.matrix.T).max()))
            assert row.sample == ((side, side) if row.figure not in (31, 33) else (160, 160))
            assert row.size == (2 * row.sample[0], 2 * row.sample[1])
    assert len(set(doses.values())) == 3


def test_report_facts() -> None:
    """What the report says of single figures is so."""
    figures = {sample.row.figure: sample for sample in drawn("report2004")}
    models = {
        figure: plugins.build("datasets", each.row.dataset, each.row.parameters) for figure, each in figures.items()
    }
    both, puzzle = figures[31], figures[33]
    assert both.texture and puzzle.texture and puzzle.row.sample and both.row.sample
    assert len(both.texture.lattices) == 3 and all(math.hypot(*t) > max(both.row.sample) for t in models[31].vectors)
    assert puzzle.texture.lattice and puzzle.texture.lattice.area > math.prod(puzzle.row.sample)
    assert models[37].small_every == 6
    assert all(models[figure].damage > 0 for figure in (43, 44))
    assert all(models[figure].bond != "stack" for figure in (36, 37, 38, 40, 41))
    assert {figures[figure].row.dataset for figure in (23, 28, 34)} == {"pie", "weave"}


def _signature(suite: Suite) -> dict[str, dict[str, object]]:
    """Return of each sample the hash of its pixels, and the mean of each of 8 x 8 blocks of them, in [0, 255]."""
    found: dict[str, dict[str, object]] = {}
    for sample in drawn(suite.name):
        assert sample.texture is not None, sample.fault
        pixels = to_bytes(sample.texture.image).mean(-1)
        rows, columns = (np.linspace(0, side, 9).astype(int) for side in pixels.shape)
        blocks = [pixels[a:b, c:d].mean() for a, b in itertools.pairwise(rows) for c, d in itertools.pairwise(columns)]
        found[sample.row.name] = {"pixels": pixels_hash(sample.texture.image), "blocks": np.round(blocks, 3).tolist()}
    return found


@pytest.mark.parametrize("name", FROZEN_SUITES)
def test_samples_are_frozen(name: str) -> None:
    """The samples are those that methods have met so far.

    The hash of the 8-bit pixels is compared first. Processors may differ in the last bit of a cosine, which now and
    then rounds a pixel to the next gray level: where a hash differs, the means of 64 blocks must agree to 0.02 gray
    levels, which no change of a model, a parameter or a draw leaves in place.

    A change of these numbers needs a reason that mentions no method's result (a model that draws something wrong, a
    fact about a figure); say it in the change log, raise the suite's version, and write the file anew by
    ``python -c "import test_suites; test_suites.write_frozen()"`` in this folder.
    """
    frozen = json.loads(FROZEN.read_text("utf-8"))[name]
    now = _signature(load_suite(name))
    assert list(now) == list(frozen)
    for row, signature in now.items():
        if signature["pixels"] != frozen[row]["pixels"]:
            np.testing.assert_allclose(signature["blocks"], frozen[row]["blocks"], atol=0.02, err_msg=row)


def write_frozen() -> None:
    """Write the signatures of all suites."""
    found = {name: _signature(load_suite(name)) for name in FROZEN_SUITES}
    FROZEN.write_text(json.dumps(found, indent=None, separators=(",", ":")).replace('},"', '},\n"') + "\n", "utf-8")


def test_stochastic_textures() -> None:
    """Twelve rows of noise, of every spectrum, and none of them has a lattice."""
    rows = [row for row in load_suite("detectors").texture if row.dataset == "noise"]
    assert len(rows) == 12 and {row.parameters["spectrum"] for row in rows} == set(SPECTRA)
    for row in rows:
        drawn = plugins.build("datasets", row.dataset, row.parameters).render((32, 32), np.random.default_rng(0))
        assert drawn.lattice is None and drawn.kind == "stochastic"
