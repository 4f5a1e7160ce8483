"""Speed and source coherence of fftm-pixel and ann-pixel, as multiples of the machine unit u.

``OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/fftm_pixel.py speed [LARGEST SIDE]`` prints what masks and
their search cost: by neighborhood with and without principal components (the paper's table 2), by output, by rules.
Kernels are warm, every figure is CPU time, each over a unit taken right beside it.

``... coherence [DIRECTORY]`` prints the mean unbroken run of the source map by search and factor (its figure 5),
with how the lattice is preserved, and writes output and source map of each as pictures. ``... weight`` prints how much
the output looks like the mask, by the mask's weight.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from unit import median_units

from nrbench.datasets_procedural.brick import Brick
from nrbench.datasets_procedural.hexagon import Hexagon
from nrbench.datasets_procedural.weave import Weave
from nrbench.imaging.convert import Image, quantize
from nrbench.imaging.files import write_image
from nrbench.jit import load_kernels
from nrbench.metrics.regularity import Regularity
from nrbench.metrics.source import SourceUse
from nrbench.plugins.forms import Observation, Synthesis, Task, Texture
from nrbench.synthesizers.ann_pixel import AnnPixel
from nrbench.synthesizers.fftm_pixel import FftmPixel
from nrbench.synthesizers.masks.texture_mask import TextureMask

FINDS = {
    "exhaustive": FftmPixel(search="exhaustive", coherence=0.0),
    "ann": FftmPixel(coherence=0.0),
    "ann eps=1": FftmPixel(coherence=0.0, eps=1.0),
    "ann coherence=1.5": FftmPixel(coherence=1.5),
    "ann coherence=2": FftmPixel(coherence=2.0),
    "ann (default)": FftmPixel(),
    "ann coherence=4": FftmPixel(coherence=4.0),
    "k-coherence": FftmPixel(search="k-coherence", coherence=0.0),
    "cluster, ann": FftmPixel(match="cluster", coherence=0.0),
    "cluster, k-coherence": FftmPixel(match="cluster", search="k-coherence", coherence=0.0),
}
MODELS = {
    "brick": Brick(color=0.27, intensity=0.13, noise=0.05),
    "weave": Weave(color=0.3, noise=0.05),
    "hexagon": Hexagon(color=0.3, noise=0.05),
}


def drawn(model: object, side: int, seed: int = 0) -> Texture:
    """Return a texture of this side, its pixels rounded to 8 bits."""
    texture: Texture = model.render((side, side), np.random.default_rng(seed))  # type: ignore[attr-defined]
    return replace(texture, image=quantize(texture.image))


def guided(method: FftmPixel, sample: Image, mask: TextureMask, side: int) -> Synthesis:
    """Return an output of this side."""
    return method.synthesize_with_mask(Task(sample, (side, side), None, np.random.default_rng(1)), mask)


def row(name: str, call: Callable[[], object], pixels: int, repeats: int = 5) -> None:
    """Print what a call costs."""
    cost = median_units(call, repeats)
    print(f"{name:44} {cost:9.1f} u   {cost / pixels * 256**2:9.1f} u per 256 x 256", flush=True)


def speed(largest: int) -> None:
    """Print the tables of costs."""
    load_kernels()
    samples = {side: drawn(MODELS["brick"], side) for side in (128, 239)}
    masks = {side: FftmPixel().find_mask(texture.image) for side, texture in samples.items()}
    row("analysis, 128 x 128", lambda: FftmPixel().find_mask(samples[128].image), 256**2, 3)
    for side, texture in samples.items():
        for size in (2, 3, 4, 5, 6):
            for dimensions in (0, 16):
                method = FftmPixel(size, dimensions=dimensions)
                name = f"{side} x {side} to 256 x 256, {size} x {size}, {'PCA' if dimensions else 'all values'}"
                row(name, lambda m=method, t=texture, s=side: guided(m, t.image, masks[s], 256), 256**2)  # type: ignore[misc]
    for name, method in FINDS.items():
        row(name, lambda m=method: guided(m, samples[128].image, masks[128], 256), 256**2, 3)  # type: ignore[misc]
    for size in (5, 8, 10):
        task = Task(samples[128].image, (256, 256), None, np.random.default_rng(1))
        row(f"ann-pixel, {size} x {size}", lambda n=size, t=task: AnnPixel(n).synthesize(t), 256**2)  # type: ignore[misc]
    for side in (256, 512, 1024, 2048):
        if side <= largest:
            row(
                f"to {side} x {side}", lambda n=side: guided(FftmPixel(), samples[128].image, masks[128], n), side**2, 3
            )  # type: ignore[misc]


def coherence(directory: Path) -> None:
    """Print the mean runs, and write the pictures."""
    for model, texture in ((name, drawn(each, 128, 3)) for name, each in MODELS.items()):
        mask = FftmPixel().find_mask(texture.image)
        for name, method in FINDS.items():
            made = guided(method, texture.image, mask, 256)
            assert made.source is not None
            seen = Observation(texture.image, quantize(made.image), texture, source=made.source)
            run, kept = SourceUse().score(seen).values["mean_copy_length"], Regularity().score(seen).values
            print(
                f"{model:8} {name:22} run {run:6.2f} px   regularity {kept['score']}, {kept['preserved']}", flush=True
            )
            places = np.concatenate([made.source[..., :2] / 127, np.zeros((256, 256, 1))], 2)
            both = np.concatenate([made.image, made.extras["mask"], places], 1)
            write_image(directory / f"{model}-{name.replace(' ', '-').replace(',', '')}.png", both.astype(np.float32))


def weight() -> None:
    """Print the correlation of output and mask by weight."""
    for model, texture in ((name, drawn(each, 128, 3)) for name, each in MODELS.items()):
        mask = FftmPixel().find_mask(texture.image)
        for c in (0.0, 0.001, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 5.0, 10.0, 100.0):
            made = guided(FftmPixel(weight=c), texture.image, mask, 256)
            like = np.corrcoef(made.image.ravel(), made.extras["mask"].ravel())[0, 1]
            kept = Regularity().score(Observation(texture.image, quantize(made.image), texture)).values
            print(f"{model:8} c = {c:<6} like the mask {like:6.3f}   preserved {kept['preserved']}", flush=True)


def main() -> None:
    """Run the study named by the first argument: speed, coherence or weight."""
    what = sys.argv[1] if len(sys.argv) > 1 else "speed"
    if what == "speed":
        speed(int(sys.argv[2]) if len(sys.argv) > 2 else 2048)
    elif what == "coherence":
        directory = Path(sys.argv[2] if len(sys.argv) > 2 else ".")
        directory.mkdir(parents=True, exist_ok=True)
        coherence(directory)
    else:
        weight()


if __name__ == "__main__":
    main()
