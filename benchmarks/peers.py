"""CPU time of quilting, of the searches and of the autocorrelation, beside other programs and plain ways.

``python benchmarks/peers.py [SUBJECT ...] [--peer COMMAND] [--block PX] [--overlap PX]``. Subjects:

``quilting``
    `quilting` beside another program, on the same samples, with the quality of both. ``--peer`` is the command line of
    the program. ``{sample}`` and ``{output}`` become paths of PNG files; ``{width}``, ``{height}``, ``{seed}``,
    ``{block}`` and ``{overlap}`` become numbers. Without it, G'MIC's ``syntexturize_matchpatch`` is the peer, which has
    no blocks (Debian: ``apt install gmic``). If there is no peer, the script says so. `quilting` is shown twice: the
    synthesis alone, which is what a cell of a run costs, and the process ``nrbench synth``, which includes the start of
    Python and all imports, as the peer's time does.
``bmquilting``
    `quilting` beside bmquilting (MIT, needs Python 3.12) in one process, with seams by least cost, on a wall of
    128 x 128 px. The calls alternate.
``windows``
    The search of `fftm-patch` for the place of a window in the sample, by sums of squared differences over six
    channels, beside ``matchTemplate`` of OpenCV, which takes three channels and is called twice. `fftm-patch`
    transforms the sample once for all windows, OpenCV at each call.
``search``
    The search of `representative-tile`, which rates every place exactly, beside brute force. The tile is that of the
    paper's figure 7-(k), of a sample of 1200 x 600 px, and half as large.
``correlation``
    The autocorrelation beside scikit-image's masked correlation, which takes one channel and is called three times.
    The last column is the largest difference over the inner half of the lags.
"""

import importlib
import shutil
import statistics
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from skimage.registration._masked_phase_cross_correlation import cross_correlate_masked
from speed import run_command, sampled
from studies import Options, run_studies
from unit import cpu_unit, median_units

import nrbench
from nrbench import CellRecord, plugins
from nrbench.detectors.ssdn import ssdn
from nrbench.imaging.convert import Image
from nrbench.imaging.correlation import half_autocorrelation
from nrbench.jit import load_kernels
from nrbench.plugins.forms import Task
from nrbench.synthesizers.patchwork.patchwork import Translations, to_gray_levels
from nrbench.synthesizers.representative_tile import continuity, resemblance

GMIC = "gmic {sample} syntexturize_matchpatch {width},{height} -o {output}"
SIDE = 256
"""px: side of the outputs."""
WALL = {"width": 196.37, "height": 74.11, "joint": 12.35, "color": 0.2, "noise": 0.03}


def find_peer(options: Options) -> str | None:
    """Return the peer's command line; None, after a sentence that says why, if its program is missing."""
    command: str = options.peer
    program = command.split()[0]
    if shutil.which(program) or Path(program).is_file():
        return command.replace("{block}", str(options.block)).replace("{overlap}", str(options.overlap))
    print(f"skipped: the peer's program {program!r} is not installed; give another one with --peer (see --help)")
    return None


def print_row(name: str, seconds: list[float], base: float, records: list[CellRecord]) -> None:
    """Print the mean CPU time, also in w and over that of quilting, and the mean quality; none counts as 0."""
    mean = statistics.fmean(seconds)
    scores = [float(one.values["quality.score"] or 0) for one in records]
    quality = f"{statistics.fmean(scores):8.3f}" if scores else ""
    print(f"{name:46} {mean:8.3f} s {mean / cpu_unit():8.1f} w {mean / base:8.1f} x {quality}", flush=True)


def show_quilting(options: Options) -> None:
    """Print time and quality of quilting and its peer."""
    peer = find_peer(options)
    if peer is None:
        return
    plugins.names("synthesizers")
    load_kernels()
    ours, size = f"quilting:block={options.block},overlap={options.overlap}", f"{SIDE}x{SIDE}"
    metrics = ["regularity", "integrity", "randomness", "quality", "cost"]
    with tempfile.TemporaryDirectory() as place:
        cells = nrbench.run(
            "core",
            methods=[ours, f"command:run={peer}"],
            textures=options.textures,
            lattice="given",
            size=size,
            metrics=metrics,
            out=Path(place, "run"),
            options=nrbench.Options(jobs=0),
        ).cells
        command = f"synth {cells[0].folder / 'sample.png'} -m {ours} --size {size} -o out.png"
        process = [run_command(command, Path(place))[1] for _ in range(3)]
    records = {name: [cell for cell in cells if cell.cell.method == name] for name in ("quilting", "command")}
    taken = {name: [float(cell.values["cost.cpu_seconds"] or 0) for cell in each] for name, each in records.items()}
    base = statistics.fmean(taken["quilting"])
    print(f"{len(records['command'])} textures of core, 128 x 128 to {SIDE} x {SIDE}")
    print(f"{'':46} {'CPU':>10} {'':10} {'':10} {'quality':>8}")
    print_row(ours, taken["quilting"], base, records["quilting"])
    print_row("the same, as a process", process, base, [])
    print_row(f"the peer {peer.split()[0]}, as a process", taken["command"], base, records["command"])


def import_peer(name: str) -> Any:
    """Return a module; None, after a sentence that says so, if it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError:
        print(f"skipped: {name.partition('.')[0]} is not installed in this Python")
        return None


def show_bmquilting(options: Options) -> None:
    """Print what quilting and bmquilting cost, at two sizes of blocks and of outputs."""
    peer = import_peer("bmquilting.square")
    if peer is None:
        return
    sample = sampled("brick", 128, color=0.3).image
    for block, overlap in ((64, 11), (40, 7)):
        config = peer.SquarePatchingConfig.with_seams(block_size=block, overlap=overlap, tolerance=0.1)
        for side in (SIDE, 4 * SIDE):
            method = plugins.build("synthesizers", "quilting", {"block": block, "overlap": overlap})
            ours, theirs = compare_costs(
                lambda m=method, n=side: m.synthesize(Task(sample, (n, n), None, np.random.default_rng(1))),
                lambda c=config, n=side: peer.generate_texture([sample], c, n, n, np.random.default_rng(1), None),
            )
            print(f"  block {block}, overlap {overlap}, {side:4} px: {ours:7.1f} w, bmquilting {theirs:7.1f} w")


def show_windows(options: Options) -> None:
    """Print what the search of a window in the sample costs, and OpenCV's, and their difference over the largest."""
    peer = import_peer("cv2")
    if peer is None:
        return
    peer.setNumThreads(1)
    for side in (128, 512):
        image = to_gray_levels(np.concatenate([sampled("brick", side, color=0.3).image] * 2, 2))
        window = image[30:54, 40:67].copy()
        halves = [(np.float32(image[..., part]), np.float32(window[..., part])) for part in (np.s_[:3], np.s_[3:])]
        search, known = Translations(image, 6), np.ones(window.shape[:2], bool)

        def match(halves: list[tuple[Any, Any]] = halves) -> Any:
            return sum(peer.matchTemplate(*half, peer.TM_SQDIFF) for half in halves)

        costs = search.compute_costs(window, known)
        error = np.abs(match() - costs).max() / costs.max()
        ours, theirs = compare_costs(lambda: search.compute_costs(window, known), match)  # noqa: B023
        print(f"  {side:4} px: {ours:7.2f} w, OpenCV {theirs:7.2f} w, difference {error:.0e}", flush=True)


def compare_costs(ours: Callable[[], object], theirs: Callable[[], object]) -> tuple[float, float]:
    """Return the median costs of two calls, w; they alternate, so that other work on the machine weighs on both."""
    pairs = [(median_units(ours, 1), median_units(theirs, 1)) for _ in range(5)]
    first, second = zip(*pairs, strict=True)
    return statistics.median(first), statistics.median(second)


def brute_force(image: Image, size: tuple[int, int], places: NDArray[np.int64]) -> list[float]:
    """Return the resemblance of some tiles (rows y, x), each repeated over the image."""
    found = []
    for y, x in places.tolist():
        tile = image[y : y + size[0], x : x + size[1]]
        rows, columns = (np.arange(image.shape[0]) - y) % size[0], (np.arange(image.shape[1]) - x) % size[1]
        found.append(ssdn(tile[rows[:, np.newaxis], columns], image))
    return found


def show_search(options: Options) -> None:
    """Print what rating every place costs, exactly, and by brute force from ten places; and how they differ."""
    wall = sampled("brick", 1200, **WALL).image[:600]
    for image, size in ((wall, (148, 196)), (wall[:300, :600], (74, 98))):
        room = (image.shape[0] - size[0] + 1, image.shape[1] - size[1] + 1)
        places = np.random.default_rng(0).integers((0, 0), room, (10, 2))
        exact, joins = (median_units(lambda f=f, a=(image, size): f(*a), 5) for f in (resemblance, continuity))
        naive = median_units(lambda a=(image, size, places): brute_force(*a), 1) / len(places) * room[0] * room[1]
        costs = resemblance(image, size)[places[:, 0], places[:, 1]]
        error = np.abs(costs - brute_force(image, size, places)).max()
        print(f"{image.shape[1]} x {image.shape[0]}, tile {size[1]} x {size[0]}: {room[0] * room[1]} places", end="")
        print(f"  exact {exact:.1f} w, continuity {joins:.1f} w, brute force {naive:.0f} w", end="")
        print(f" ({naive / exact:.0f} times), difference {error:.0e}", flush=True)


def show_correlation(options: Options) -> None:
    """Print the cost of the autocorrelation and of scikit-image's, and their difference in the first channel."""
    for side in (128, 256, 512):
        image, mask = sampled("brick", side).image, np.ones((side, side), bool)

        def peer(planes: np.ndarray, mask: np.ndarray = mask) -> list[np.ndarray]:
            return [cross_correlate_masked(each, each, mask, mask, overlap_ratio=0) for each in planes]

        planes = np.moveaxis(image, 2, 0)
        ours = median_units(lambda image=image: half_autocorrelation(image))
        theirs = median_units(lambda planes=planes, peer=peer: peer(planes), 3)
        exact = peer(planes[:1].astype(np.float64))[0][:, side - 1 :]
        inner = np.s_[side - 1 - side // 2 : side + side // 2, : side // 2 + 1]
        difference = np.abs(half_autocorrelation(image[..., :1]) - exact)[inner].max()
        print(f"  {side:4} px: {ours:7.1f} w, scikit-image {theirs:9.1f} w, difference {difference:.1e}", flush=True)


if __name__ == "__main__":
    studies = (show_quilting, show_bmquilting, show_windows, show_search, show_correlation)
    run_studies(__doc__, *studies, peer=GMIC, block=64, overlap=11, textures=["*"])
