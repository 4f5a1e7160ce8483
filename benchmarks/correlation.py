"""Speed and agreement of the autocorrelation, beside scikit-image's masked correlation on the same image.

Run it on one thread: ``OMP_NUM_THREADS=1 python benchmarks/correlation.py``. scikit-image's takes one channel, so it is
called three times. The last column is the largest difference, over the inner half of the lags, of the first channel.
"""

from __future__ import annotations

import numpy as np
from skimage.registration._masked_phase_cross_correlation import cross_correlate_masked
from unit import machine_unit, median_seconds

from nrbench.datasets_procedural.brick import Brick
from nrbench.imaging.convert import Image, quantize
from nrbench.imaging.correlation import half_autocorrelation


def peer(image: Image) -> list[np.ndarray]:
    """Return scikit-image's autocorrelation of each channel."""
    mask = np.ones(image.shape[:2], bool)
    return [cross_correlate_masked(plane, plane, mask, mask, overlap_ratio=0) for plane in np.moveaxis(image, 2, 0)]


def difference(image: Image) -> float:
    """Return the largest difference to scikit-image's (in double precision) in the inner half of the lags."""
    height, width = image.shape[:2]
    inner = np.s_[height - 1 - height // 2 : height + height // 2, : width // 2 + 1]
    channel = image[..., :1]
    right = peer(channel.astype(np.float64))[0][:, width - 1 :]
    return float(np.abs(half_autocorrelation(channel) - right)[inner].max())


def main() -> None:
    """Print the table."""
    u = machine_unit()
    print(f"u = {u * 1e3:.2f} ms\n\nsize            ours    scikit-image   ratio   difference")
    for side in (128, 256, 512, 1024):
        image = quantize(Brick().render((side, side), np.random.default_rng(0)).image)
        ours = median_seconds(lambda image=image: half_autocorrelation(image))
        theirs = median_seconds(lambda image=image: peer(image), 3)
        times = f"{ours / u:7.1f} u {theirs / u:11.1f} u {theirs / ours:7.1f}"
        print(f"{side:4} x {side:<4} {times}   {difference(image):.1e}")


if __name__ == "__main__":
    main()
