from typing import Any

import numpy as np
import pytest
from synthesis_cases import noise, smooth, synthesize

from nrbench import texture
from nrbench.imaging.convert import Image, quantize
from nrbench.metrics.regularity import Regularity
from nrbench.plugins.forms import Observation, Task, Texture
from nrbench.synthesizers.canvas.canvas import Window
from nrbench.synthesizers.graph_cuts import GraphCuts
from nrbench.synthesizers.patchwork.patchwork import Patchwork, SeamHeat, WholePatches


def made(sample: Image, shape: tuple[int, int], seed: int = 1, **options: Any) -> tuple[Patchwork, WholePatches]:
    """Return an output that is filled but not refined."""
    task = Task(sample, shape, None, np.random.default_rng(seed))
    work, patches = GraphCuts(**options).prepare(task)
    while (region := patches.find_unknown()) is not None:
        patches.cover_region(region)
    return work, patches


@pytest.mark.parametrize("placement", ["entire", "sub-patch"])
def test_a_periodic_sample_goes_on_exactly(placement: Any) -> None:
    """The output of a periodic sample is the periodic picture, exactly, and refinement leaves no seam of any cost."""
    tile = quantize(smooth(12, 17))
    sample = np.tile(tile, (5, 4, 1))
    work, patches = made(sample, (150, 140), placement=placement, randomness=0.0)
    image, whole = work.output()[0], np.tile(tile, (14, 10, 1))
    equal = [(whole[y : y + 150, x : x + 140] == image).all() for y, x in np.ndindex(12, 17)]
    assert sum(equal) == 1
    # Where two patches meet at the edge of one of them, its outermost pixels are repeated; that seam has a cost.
    heat = SeamHeat(work, patches.size)
    for _ in range(40):
        region = heat.find_worst()
        patches.cover_region(region)
        heat.update(region, 68)
    assert work.cost == 0
    np.testing.assert_array_equal(work.output()[0], image)


def test_refinement_stops_when_it_does_not_pay(monkeypatch: pytest.MonkeyPatch) -> None:
    """The last pass is the first one of little gain, and there is none where no seam is left."""
    chosen: list[Window] = []
    cover = WholePatches.cover_region

    def note(patches: WholePatches, region: Window, *pixel: Any) -> int:
        chosen.extend([region] * len(pixel))
        return cover(patches, region, *pixel)

    monkeypatch.setattr(WholePatches, "cover_region", note)
    costs = iter([100.0, 90.0, 90.0, 89.5])
    monkeypatch.setattr(Patchwork, "cost", property(lambda self: next(costs)))
    synthesize(GraphCuts(passes=9), noise(30, 30), (60, 60))
    assert len(chosen) == 2 * 16
    monkeypatch.setattr(Patchwork, "cost", property(lambda self: 0.0))
    synthesize(GraphCuts(passes=9), noise(30, 30), (60, 60))
    assert len(chosen) == 2 * 16


@pytest.mark.parametrize("seed", [0, 1])
def test_refinement_never_leaves_costlier_seams(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Forced pixels make a pass on a weave costlier; it is undone, so that the seams are those of the fill."""
    sample = texture("weave", shape=(96, 96), seed=seed, color=0.3, noise=0.03).image
    filled, _ = made(sample, (160, 160), seed)
    works: list[Patchwork] = []
    prepare = GraphCuts.prepare

    def keep(method: GraphCuts, task: Task) -> tuple[Patchwork, WholePatches]:
        work, patches = prepare(method, task)
        works.append(work)
        return work, patches

    monkeypatch.setattr(GraphCuts, "prepare", keep)
    GraphCuts().synthesize(Task(sample, (160, 160), None, np.random.default_rng(seed)))
    assert works[0].cost <= filled.cost


def test_a_forced_paste_always_shows_the_patch(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every step of refinement changes at least one pixel."""
    changed: list[int] = []
    lay = WholePatches.cover_region

    def noting(*given: Any) -> int:
        changed.append(lay(*given))
        return changed[-1]

    monkeypatch.setattr(WholePatches, "cover_region", noting)
    synthesize(GraphCuts(refine="minima", passes=2), noise(30, 30), (60, 60))
    assert len(changed) > 16 and min(changed) > 0


@pytest.mark.parametrize("name", ["brick", "weave", "hexagon"])
def test_regular_samples_stay_regular(name: str) -> None:
    """On textures without departures entire-patch matching preserves the lattice; random placement loses it."""
    made = texture(name, shape=(96, 96), seed=2)
    sample = quantize(made.image)
    truth = Texture(sample, made.lattice)
    for placement, preserved in (("entire", True), ("random", False)):
        method = GraphCuts(placement=placement, passes=0)
        output = quantize(synthesize(method, sample, (160, 160)).image)
        verdict = Regularity().score(Observation(sample, output, truth)).values
        assert verdict["preserved"] is preserved


def test_the_preset_of_the_paper_has_its_variants() -> None:
    """The preset ``paper`` has the cost and the placement of the paper, and a k in its range."""
    method = GraphCuts(**GraphCuts.presets["paper"])
    assert (method.placement, method.refine, method.normalized) == ("entire", "worst", True)
    assert 0.001 <= method.randomness <= 1
