"""Sums of products of an image and a template, at every place of the template, by Fourier transforms."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

Spectra = NDArray[np.complex128]
"""``(C, rows, columns)``: the spectra of some planes, padded with zeros."""


class FourierProducts:
    """Correlates images with templates; the sums of products are exact for whole numbers.

    Parameters
    ----------
    shape
        Shape (height, width, ...) of the largest image.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self._shape = tuple(scipy.fft.next_fast_len(side, real=True) for side in shape[:2])

    def transform(self, planes: NDArray[Any]) -> Spectra:
        """Return the spectra of planes ``(C, h, w)``."""
        lines = scipy.fft.rfft(np.ascontiguousarray(planes, np.float64), self._shape[1], axis=2)
        return np.asarray(scipy.fft.fft(lines, self._shape[0], axis=1))

    def correlate(self, image: Spectra, template: Spectra, counts: tuple[int, int]) -> NDArray[np.float64]:
        """Return the sum of products of a template and the image under it at the first ``counts`` rows and columns.

        Rows are transformed before they are padded below, and after the columns are cut, which saves time. The result
        is rounded to whole numbers.
        """
        product = np.einsum("chw,chw->hw", image, template.conj())
        lines = scipy.fft.ifft(product, axis=0)[: counts[0]]
        return np.rint(scipy.fft.irfft(lines, self._shape[1], axis=1)[:, : counts[1]])
