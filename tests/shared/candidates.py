"""A detector that returns a ranked list of candidates, for tests of what is printed, drawn and written of them."""

from dataclasses import dataclass

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Alternative, Detection, NoLatticeFound, Probabilities

CHOSEN = Lattice((16.0, 0.0), (0.0, 12.0))
OTHERS = (
    Alternative(Lattice((32.0, 0.0), (0.0, 12.0)), 0.2, "double along t1", 0.31),
    Alternative(Lattice((8.0, 0.0), (0.0, 12.0)), 0.1, "half along t1", 0.25),
    Alternative(Lattice((16.0, 0.0), (0.0, 36.0)), 0.05, "x 3 along t2", 0.2),
)


@dataclass(frozen=True)
class Ranked:
    """Return the same candidates for any image that is not dark; the brightness is the confidence."""

    version = "1"

    def detect(self, image: Image) -> Detection:
        """Return the candidates."""
        confidence = float(image.max())
        if confidence < 0.2:
            best = Detection(CHOSEN, confidence)
            raise NoLatticeFound("the picture is dark", best)
        if image.shape[0] == 13:
            raise ArithmeticError("thirteen rows")
        rest = 1 - confidence
        probabilities = Probabilities(confidence, rest / 2, rest / 2)
        return Detection(CHOSEN, confidence, {}, OTHERS, probabilities)
