"""Claims that many methods share: copies, exact continuation, lattices with fractional vectors, and parameters."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthesis_cases import BOND, FRACTIONAL, OBLIQUE, UPRIGHT, WHOLE, build, noise, synthesize, waves

from nrbench import texture
from nrbench.calling.method_calls import checked_synthesis
from nrbench.errors import BadInput
from nrbench.imaging.convert import Image, quantize, to_bytes
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.parameters import parse_spec

COPYING = {
    "ann-pixel": 1,
    "ann-pixel:neighborhood=10,search=exhaustive,coherence=0": 1,
    "ann-pixel:neighborhood=2,search=k-coherence,coherence=2.5": 1,
    "graph-cuts:passes=1,feather=0": 1,
    "graph-cuts:placement=sub-patch,region=0.3": 0,
    "graph-cuts:placement=random,feather=2": 0,
    "graph-cuts:refine=random,normalized=false": 0,
    "graph-cuts:refine=minima": 0,
    "graph-cuts:refine=extremes": 0,
    "patch-based:patch=16,zone=4": 0.25,
    "patch-based:patch=16,zone=4,search=kdtree": 0.25,
    "quilting:block=12": 1,
    "representative-tile": 0,
    "representative-tile:rescale=false": 0,
    "rsgf:block=2,border=1": 0.25,
    "rsgf:block=3,border=1,seam=blend": 1 / 12,
    "rsgf:block=15,border=7,subpixel=false": 1,
    "rsgf:block=15,border=7,subpixel=false,seam=quilting": 1,
    "rsgf:block=15,border=7,deform=3": 0.25,
    "rsgf:block=15,border=7,subpixel=false,seam=blend": 1 / 3,
    "scatter:block=12,border=3": 0,
    "shuffle": 0,
    "tile-set": 0,
    "tile-set:parts=4": 0,
    "tile-set:stitch=dynamic": 0,
    "tile-set:tile=upright": 0,
    "tiling": 0,
}
"""Methods that copy, and the least weight of a pixel."""
LEANING = Lattice((9.3, 1.2), (-2.1, 10.4))


@pytest.mark.parametrize("spec", COPYING)
@settings(max_examples=8)
@given(st.tuples(st.integers(1, 60), st.integers(1, 60)), st.sampled_from([1, 3]), st.integers(0, 99))
def test_what_the_source_map_calls_a_copy_is_one(spec: str, shape: tuple[int, int], channels: int, seed: int) -> None:
    """For any shape, the sources lie in the sample, whole ones of weight 1 are copies, and all rebuild the output."""
    sample = noise(50, 45, channels)
    made = checked_synthesis(synthesize(build(spec), sample, shape, LEANING, seed), sample, shape)
    x, y, weight = np.moveaxis(made.source, -1, 0)
    assert ((x >= -0.5) & (x <= 44.5) & (y >= -0.5) & (y <= 49.5) & (weight > 0) & (weight <= 1)).all()
    assert weight.min() >= COPYING[spec] - 1e-6
    copied = (weight == 1) & (x == np.rint(x)) & (y == np.rint(y))
    np.testing.assert_array_equal(made.image[copied], sample[y[copied].astype(int), x[copied].astype(int)])
    apart = np.abs(made.apply(sample) - np.clip(made.image, sample.min(), sample.max())).max()
    assert apart < 2.1 / 255 or "dynamic" in spec  # more than four tiles may be blended there


ANY_LATTICE = [
    "tile-set", "tile-set:tile=upright", "tile-set:tile=lattice", "tile-set:tile=rectangle", "tile-set:tile=cell",
    "tile-set:stitch=dynamic", "tile-set:cells=2", "tile-set:cells=2,stitch=dynamic",
    "tile-set:preset=paper,registration=0", "shuffle",
]  # fmt: skip
UPRIGHT_LATTICE = [
    "rsgf", "rsgf:match=ncc", "rsgf:search=everywhere", "rsgf:seam=blend", "rsgf:seam=quilting",
    "rsgf:deform=2", "rsgf:subpixel=false",
    "rsgf:subpixel=false,seam=blend", "tiling", "representative-tile", "representative-tile:rescale=false",
    "regularized-patch", "regularized-patch:texel=quadrilateral", "regularized-patch:texel=given",
]  # fmt: skip


def periodic(shape: tuple[int, int], lattice: Lattice, channels: int) -> Image:
    """Return noise that repeats exactly on a lattice of whole pixels."""
    x, y = np.meshgrid(np.arange(shape[1]), np.arange(shape[0]))
    wrapped = np.rint(lattice.wrap(np.stack([x, y], -1))).astype(int)
    return noise(101, 101, channels)[wrapped[..., 1], wrapped[..., 0]]


@pytest.mark.parametrize(
    ("spec", "lattice", "channels"),
    [(spec, lattice, 3) for spec in ANY_LATTICE for lattice in WHOLE[1:]]
    + [(spec, WHOLE[2], 1) for spec in ANY_LATTICE]
    + [(spec, WHOLE[0], channels) for spec in ANY_LATTICE + UPRIGHT_LATTICE for channels in (1, 3)],
)
def test_a_whole_pixel_lattice_is_continued_exactly(spec: str, lattice: Lattice, channels: int) -> None:
    """On a perfectly periodic sample the output is the periodic continuation, phase included, to the bit."""
    picture = periodic((240, 300), lattice, channels)
    for shape in ((180, 170), (1, 300), (150, 1), (9, 5)):
        made = synthesize(build(spec), picture[:160, :160], shape, lattice)
        np.testing.assert_array_equal(to_bytes(made.image), to_bytes(picture[: shape[0], : shape[1]]))


SLANTED = Lattice((20.3, 0), (6.1, 18.7))


@pytest.mark.parametrize(
    ("spec", "lattice", "side", "shape", "decibels"),
    [
        ("regularized-patch", FRACTIONAL, 110, (600, 600), 42.11),
        *(
            ("representative-tile", each, 128, (200, 1024), 35)
            for each in (UPRIGHT, FRACTIONAL, BOND, OBLIQUE, SLANTED)
        ),
        *((f"rsgf:seam={seam}", FRACTIONAL, 128, (512, 144), 45) for seam in ("graphcut", "blend")),
        *((f"rsgf:seam={seam}", FRACTIONAL, 128, (144, 512), 45) for seam in ("graphcut", "blend")),
        *((f"tiling:tile={tile}", OBLIQUE, 90, (800, 800), 48.14) for tile in ("typical", "random")),
        ("supertile", OBLIQUE, 90, (800, 800), 48.14),
    ],
)
def test_a_fractional_lattice_neither_drifts_nor_blurs(
    spec: str, lattice: Lattice, side: int, shape: tuple[int, int], decibels: float
) -> None:
    """A smooth texture with fractional vectors is continued with this PSNR, in the farthest corner, too."""
    sample, truth = quantize(waves((side, side), lattice)), waves(shape, lattice)
    error = (synthesize(build(spec), sample, shape, lattice).image - truth) ** 2
    assert -10 * np.log10(error.mean()) > decibels
    assert -10 * np.log10(error[-100:, -100:].mean()) > decibels


@pytest.mark.parametrize(
    ("spec", "lattice"),
    [("tile-set", FRACTIONAL), ("tile-set:parts=4", FRACTIONAL)]
    + [("representative-tile", each) for each in (UPRIGHT, FRACTIONAL, BOND, OBLIQUE)],
)
def test_sources_stay_on_the_lattice(spec: str, lattice: Lattice) -> None:
    """On noise every pixel of 1024 px comes from near its equals, and the mean distance does not grow.

    Near is 0.1 s; for the representative tile it is half a pixel along x and y.
    """
    for shape in ((1024, 96), (96, 1024)):
        source = synthesize(build(spec), noise(128, 128), shape, lattice).source
        y, x = np.indices(shape)
        misplaced = lattice.wrap(source[..., :2] - np.stack([x, y], -1))
        off = np.hypot(*np.moveaxis(misplaced, -1, 0))
        assert off.max() < 0.1 * lattice.s
        assert spec != "representative-tile" or np.abs(misplaced).max() <= 0.5 + 1e-3
        assert off[-256:, -256:].mean() == pytest.approx(off[:256, :256].mean(), rel=0.15)


@pytest.mark.parametrize("lattice", [Lattice((20, 5), (-4, 22)), FRACTIONAL, BOND])
@pytest.mark.parametrize(
    "spec", ["rsgf", "rsgf:seam=blend,subpixel=false,tolerance=3", "representative-tile", "resample"]
)
def test_any_basis_of_the_lattice_gives_the_same_bytes(spec: str, lattice: Lattice) -> None:
    """Long, skewed generating vectors of the same lattice change nothing."""
    skewed = Lattice(lattice.t1, (3 * lattice.t1[0] + lattice.t2[0], 3 * lattice.t1[1] + lattice.t2[1]))
    made = [synthesize(build(spec), noise(128, 128), (100, 100), basis).image for basis in (lattice, skewed)]
    np.testing.assert_array_equal(*made)


@pytest.mark.parametrize(
    "spec",
    [
        "representative-tile",
        "resample",
        "texture-optimization",
        "gpnn",
        *(f"rsgf:block=8,border=2,match={m},seam={s}" for m in ("ncc", "color") for s in ("graphcut", "blend")),
        "rsgf:block=8,border=2,seam=quilting,deform=2",
    ],
)
def test_a_flat_sample_gives_a_flat_output(spec: str) -> None:
    """A sample without any structure to match, rate or cut around is no error."""
    made = synthesize(build(spec), np.full((60, 60, 1), 0.4, np.float32), (40, 40), UPRIGHT)
    np.testing.assert_allclose(made.image, 0.4, atol=1e-6)


CHANGES = {
    "ann-pixel": "neighborhood=5 search=k-coherence,coherence=0 coherence=1 dimensions=4",
    "cartoon": "grain=white",
    "fftm-patch": "weight=0 patch=40 overlap=0.5 randomness=0.3 matching=entire refinements=1 refinements=2 "
    "normalized=false threshold=12 channels=each",
    "fftm-pixel": "neighborhood=4 weight=0.5 match=cluster search=k-coherence,coherence=0 coherence=0 dimensions=4 "
    "distance=squares threshold=12",
    "gpdm:steps=20": "patch=5 projections=2 rate=0.05 ratio=0.6 coarsest=40 noise=0.5",
    "gpnn": "patch=5 alpha=0 alpha=1 iterations=1 first_iterations=1 coarsest=40 noise=0.2",
    "graph-cuts": "placement=sub-patch placement=random randomness=1 region=0.4 refine=random refine=minima "
    "refine=extremes passes=0 normalized=false feather=2",
    "patch-based": "patch=16 zone=5 epsilon=1",
    "quilting": "block=16 overlap=6 tolerance=0.5",
    "representative-tile": "continuity_weight=0 rescale=false edge_colors=2 edge_colors=3",
    "representative-tile:continuity_weight=1": "rated_share=1e-4",
    "resample": "variation=0.5",
    "rsgf": "block=36 border=8 match=ncc search=everywhere search=stochastic tolerance=0 subpixel=false seam=blend "
    "seam=quilting deform=2 candidate_fraction=0 candidate_fraction=1 prefer_unused=false",
    "texture-optimization": "neighborhood=16 levels=1 iterations=2 exponent=2",
    "tile-set": "tile=upright tile=rectangle tile=cell cells=2 quantile=0.1 threshold=30 registration=3 parts=3 "
    "margin=0 stitch=dynamic anchor=quiet anchor=given threshold=40,overlap_measure=sum",
}


@pytest.mark.parametrize("name", CHANGES)
def test_every_parameter_changes_something(name: str) -> None:
    """Every parameter has an effect on a sample that varies, also in brightness."""
    wall = texture("brick", (96, 96), 2, color=0.3, noise=0.05, intensity=0.2)
    sample = quantize(wall.image * np.linspace(0.7, 1, 96, dtype=np.float32)[:, np.newaxis, np.newaxis])
    base = synthesize(build(name), sample, (120, 120), wall.lattice).image
    for change in CHANGES[name].split():
        changed = f"{name}{',' if ':' in name else ':'}{change}"
        assert (synthesize(build(changed), sample, (120, 120), wall.lattice).image != base).any(), change


BAD = {
    "ann-pixel": "neighborhood=1 neighborhood=11 coherence=0.5 coherence=nan dimensions=-1",
    "auto": "threshold=2",
    "fftm-patch": "weight=-1 weight=100.5 weight=nan patch=-1 patch=2 overlap=-0.1 overlap=0.95 overlap=nan "
    "randomness=-1 randomness=inf randomness=nan refinements=-1 threshold=-1 "
    "threshold=255 threshold=nan tileable=true,harmonics=free",
    "fftm-pixel": "neighborhood=1 neighborhood=7 weight=-1 weight=nan weight=101 coherence=0.5 coherence=inf "
    "coherence=nan dimensions=-1 weight=1,match=cluster tileable=true,harmonics=free threshold=-1",
    "gpdm": "patch=2 projections=0 steps=0 rate=0 rate=nan ratio=0.2 ratio=1 coarsest=0 noise=-1",
    "gpnn": "patch=2 alpha=-1 alpha=1e-9 alpha=nan iterations=0 first_iterations=0 coarsest=0 noise=-1 noise=nan",
    "graph-cuts": "randomness=-0.1 randomness=inf randomness=1e300 randomness=nan region=0 region=0.9 passes=-1 "
    "feather=-1 feather=9 feather=1e-200 feather=nan",
    "patch-based": "patch=2 zone=7,patch=12 zone=-1 epsilon=-0.1 epsilon=nan epsilon=1e200",
    "quilting": "block=2 block=-5 overlap=7,block=12 overlap=-1 tolerance=-0.1 tolerance=nan tolerance=inf "
    "tolerance=1e200",
    "random-phase": "fade=-0.1 fade=0.6",
    "regularized-patch": "zone=-1 zone=nan tolerance=-0.1 tolerance=1e300",
    "representative-tile": "continuity_weight=-1 continuity_weight=1e308 rated_share=0 rated_share=1.5 tolerance=0.5 "
    "edge_colors=0 edge_colors=4 best_tiles=0 best_tiles=100",
    "rsgf": "border=-1 border=21 block=1 tolerance=-1 tolerance=3,search=everywhere tolerance=3,search=stochastic "
    "candidate_fraction=-0.1 candidate_fraction=1.5 candidate_fraction=nan candidate_fraction=0.5,search=everywhere "
    "deform=-1 deform=nan deform=11 deform=3,border=2",
    "scatter": "border=11,block=20",
    "texture-optimization": "neighborhood=7 levels=0 iterations=0 exponent=0 exponent=2.5 exponent=nan",
    "tile-set": "quantile=1.2 threshold=-1 threshold=nan registration=-1 margin=-1 registration=inf parts=0 parts=17 "
    "cells=0 cells=65",
}


@pytest.mark.parametrize("spec", [f"{name}:{wrong}" for name, every in BAD.items() for wrong in every.split()])
def test_bad_parameters_are_named(spec: str) -> None:
    """The error names the parameter that is out of range or has no effect, and says what to choose."""
    (name, *_) = parse_spec(spec)[1]
    with pytest.raises(BadInput, match=f"{name}.* (choose|drop one)"):
        build(spec)
