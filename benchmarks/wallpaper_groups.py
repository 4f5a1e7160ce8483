"""How often the wallpaper group of a texture is right, wrong, or not told, by its regular share.

``OMP_NUM_THREADS=1 python benchmarks/wallpaper_groups.py [--first 100] [--count 6] [--detect]``. Each seed draws all 17
groups at three regular shares: periods of 20 to 40 px, 4 to 7 of them along each side, every other seed turned, and
departures of color, grain or place. Seeds under 100 have set the limits of the recognition. ``ideals`` prints the
groups of the ideal pictures of other models.
"""

import itertools
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from studies import read_options
from validation import at_share

from nrbench import plugins
from nrbench.datasets_procedural.wallpaper import GROUPS, Wallpaper
from nrbench.imaging.convert import quantize
from nrbench.imaging.wallpaper_group import find_wallpaper_group
from nrbench.jit import load_kernels
from nrbench.plugins.forms import NoLatticeFound, Texture

SHARES = (0.9, 0.6, 0.3)
DEPARTURES = (
    {"color": 1.0, "intensity": 0.5, "noise": 0.1},
    {"noise": 1.0, "color": 0.3, "light": 0.5},
    {"jitter": 1.0, "color": 0.5, "noise": 0.05},
)
"""Departures of a share near 0; weaker ones of the same proportions give the others."""
IDEALS = ("brick", "weave", "hexagon", "squares", "basket", "scales", "mat", "plaid", "pavement", "windows", "carpet")


def draw(seed: int) -> Iterator[tuple[str, float, Texture]]:
    """Yield group, regular share and texture of each model of a seed."""
    rng = np.random.default_rng(seed)
    for number, (group, share) in enumerate(itertools.product(GROUPS, SHARES)):
        width, height = rng.uniform(20, 40, 2)
        rotation, slant = (float(rng.uniform(5, 85)) if seed % 2 else 0.0), float(rng.choice([0.0, 20.0]))
        model = Wallpaper(width=width, height=height, group=group, motif=seed, rotation=rotation, noise=0, color=0)
        model = replace(model, intensity=0, slant=slant if group in ("p1", "p2") else 0.0)
        departures = DEPARTURES[(seed + number) % len(DEPARTURES)]
        side = round(rng.uniform(4, 7) * max(np.hypot(*vector) for vector in model.vectors))
        texture = at_share(model, departures, share, 7).render((side, side), np.random.default_rng(seed))
        yield group, share, texture


def tell(texture: Texture, detect: bool) -> str | None:
    """Return the group of a texture, with its own lattice or a detected one."""
    image, lattice = quantize(texture.image), texture.lattice
    if detect:
        try:
            lattice = plugins.build("detectors", "consensus").detect(image).lattice
        except NoLatticeFound:
            return None
    assert lattice is not None
    return find_wallpaper_group(image, lattice).group


def print_ideals() -> None:
    """Print the group of the ideal picture of other models."""
    for name in IDEALS:
        texture = plugins.build("datasets", name, {}).render((240, 240), np.random.default_rng(1))
        assert texture.ideal is not None and texture.lattice is not None
        found = find_wallpaper_group(texture.ideal, texture.lattice)
        print(f"{name:10} {found.group or 'cannot tell: ' + found.reason}")


def main() -> None:
    """Print the table, and each wrong group."""
    choices = {"what": ("groups", "ideals")}
    options = read_options(__doc__, ["what"], choices, what="groups", first=100, count=6, detect=False)
    load_kernels()
    if options.what == "ideals":
        return print_ideals()
    answers: Counter[tuple[float, str]] = Counter()
    for seed in range(options.first, options.first + options.count):
        for group, share, texture in draw(seed):
            told = tell(texture, options.detect)
            answers[share, "right" if told == group else "cannot tell" if told is None else "wrong"] += 1
            if told not in (None, group):
                print(f"seed {seed}: {group} at share {share}: {told}", flush=True)
    print(f"{'share':>5} {'right':>6} {'cannot tell':>12} {'wrong':>6} {'n':>5}")
    for share in SHARES:
        counts = [answers[share, answer] for answer in ("right", "cannot tell", "wrong")]
        right, open_, wrong = (100 * count / sum(counts) for count in counts)
        print(f"{share:5} {right:4.0f} % {open_:10.0f} % {wrong:4.0f} % {sum(counts):5}")


if __name__ == "__main__":
    main()
