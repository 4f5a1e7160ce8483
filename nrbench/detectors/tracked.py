"""The lattice of a picture that may be bent: found in views of the picture, followed through all of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Literal

from nrbench.detectors.autocorrelation.surrogates import require_texture
from nrbench.displacement.bent_detection import find_deformation
from nrbench.errors import require
from nrbench.imaging.convert import Image
from nrbench.plugins.forms import Detection
from nrbench.plugins.registry import bent_finders


@dataclass(frozen=True)
class Tracked:
    """Tracking: lattices of pictures that are straight, wavy, or seen in perspective, vertex by vertex.

    This is what ``nrbench lattice`` does with a bent picture
    (:func:`~nrbench.displacement.bent_detection.find_deformation`). If the lattice that ``consensus`` finds lies in the
    whole picture without deformation, it is the answer. Else ``gncc`` proposes lattices in overlapping views, each is
    followed outward through the picture by correlation with the mean tile, and ``consensus`` has to find it again in
    the picture that is straightened by it.

    The lattice is the mean one: of all regular lattices it lies nearest to the vertices. The confidence is that of
    ``consensus`` on the straightened picture. If no followed lattice explains the picture, the answer is that of
    ``consensus``.

    Parameters
    ----------
    reject
        ``"half"``: report no lattice if no proposal can be followed through about half of the picture at first.
        ``"none"``: follow all. This finds more of the lattices that are strongly bent, takes longer where there is
        none, and sometimes finds one in noise.

    References
    ----------
    .. [1] M. Park, K. Brocklehurst, R. T. Collins, Y. Liu, "Deformed lattice detection in real-world images using
           mean-shift belief propagation", IEEE PAMI 31(10), 2009, set the task: the vertices of a deformed lattice. The
           algorithm here is another one.
    """

    reject: Literal["none", "half"] = "half"

    version: ClassVar[str] = "1"
    uses: ClassVar[tuple[str, ...]] = bent_finders()

    def __post_init__(self) -> None:
        require(self.reject in ("none", "half"), f"tracked: reject is {self.reject!r}; give none or half")

    def detect(self, image: Image) -> Detection:
        """Return the mean lattice of ``image``, and the vertices where they lie; their origin is that of the lattice.

        Diagnostics: those of ``consensus`` on the straightened picture, ``bent`` (1 or 0), ``amplitude`` (root mean
        square displacement, in s) and ``covered`` (share of the picture in which the lattice was followed).

        Raises
        ------
        NoLatticeFound
            If the image is constant, or no view has a lattice that can be followed.
        """
        require_texture(image)
        found, detection = find_deformation(image, only_promising=self.reject == "half")
        assert detection is not None
        known = {"bent": float(found.bent), "amplitude": found.amplitude, "covered": found.covered}
        return replace(
            detection,
            lattice=found.lattice,
            has_origin=False,
            vertices=found.lattice_points,
            diagnostics={**detection.diagnostics, **known},
        )
