"""Choose how closely `resample` matches colors where it copies detail: ``python docs/choose_detail.py``.

The suites ``core`` and ``default`` are drawn at seed 77, which no table reports. Printed is the mean over their
textures of quality, integrity and repetition of `resample`, the lattice given, for each width in standard deviations of
the colors.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import nrbench
from nrbench.synthesizers.resampling import element_detail

WIDTHS = (0.4, 0.8, 1.2, 1.6, 3.2)
COLUMNS = ["quality.score", "integrity.score", "randomness.repetition"]


def main() -> None:
    """Run the widths, and print a table."""
    print(f"| sigmas | {' | '.join(f'{suite}: {name}' for suite in ('core', 'default') for name in COLUMNS)} |")
    for width in WIDTHS:
        element_detail._ALIKE = width
        means = []
        for suite in ("core", "default"):
            run = nrbench.run(
                suite,
                methods="resample",
                lattice="given",
                seed=77,
                replicates=1,
                out=Path(tempfile.mkdtemp()) / "run",
                options=nrbench.Options(jobs=0),
            )
            means += [float(run.table()[name].mean()) for name in COLUMNS]
        print(f"| {width} | {' | '.join(f'{mean:.3f}' for mean in means)} |", flush=True)


if __name__ == "__main__":
    main()
