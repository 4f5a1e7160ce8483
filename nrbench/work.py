"""The work of a process: clocks that leave the compilation of kernels out, and results that are reused.

What the methods of a run find of a sample is the same for several of them. A process that runs many cells keeps the
latest of these results (:func:`make_once`). The clocks advance by what a result took whenever it is reused, so that it
counts as a cost of each method that uses it.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, ParamSpec, TypeVar

import numpy as np

from nrbench.jit import COMPILATION

P = ParamSpec("P")
R = TypeVar("R")
MOST_KEPT = 8
"""Number of results that are kept: those of the latest sample."""
MIB = 1 << 20


@dataclass(frozen=True)
class Spent:
    """What a piece of work cost.

    Parameters
    ----------
    seconds, cpu_seconds
        Wall and processor seconds.
    peak_mib
        By how much it raised the peak memory of its process, MiB.
    """

    __pydantic_config__ = {"allow_inf_nan": False}  # read by pydantic, which takes long to import
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    peak_mib: float = 0.0


@dataclass
class ReusedWork:
    """The results that this process keeps, and what those cost that it has reused.

    Parameters
    ----------
    kept
        The results by a hash of what they depend on, with their costs, the latest last.
    active
        Whether results are kept now.
    seconds, cpu_seconds
        Sums over all uses of an earlier result.
    peak_mib
        The highest peak of an earlier result that was used since :func:`keep_results` began.
    held_bytes
        The highest resident size of the process before that.
    """

    kept: dict[bytes, tuple[Any, Spent]] = field(default_factory=dict)
    active: bool = False
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    peak_mib: float = 0.0
    held_bytes: int = 0

    def count(self, spent: Spent) -> None:
        """Count the cost of an earlier result as a cost of the present work."""
        self.seconds += spent.seconds
        self.cpu_seconds += spent.cpu_seconds
        self.peak_mib = max(self.peak_mib, spent.peak_mib)


REUSED = ReusedWork()
"""The reused work of this process."""


def work_clock() -> float:
    """Return :func:`time.perf_counter` without the compilation of kernels, with what reused results took."""
    return time.perf_counter() - COMPILATION.seconds + REUSED.seconds


def cpu_seconds() -> float:
    """Return the processor seconds so far of this process, all threads, and of the programs that it has waited for.

    The compilation of kernels is left out, and what reused results took is counted.
    """
    times = os.times()
    own = time.process_time() + times.children_user + times.children_system
    return own - COMPILATION.cpu + REUSED.cpu_seconds


def peak_bytes() -> int:
    """Return the highest resident size of this process so far, bytes."""
    if sys.platform == "win32":
        import psutil

        return int(psutil.Process().memory_info().peak_wset)
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else peak * 1024)


def measure_cost(function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> tuple[R, Spent]:
    """Return what a function returns, and what that cost, with the results that it reused.

    The peak is that since :func:`keep_results` began: where earlier work of the block has taken as much memory, the
    function raises it no more.
    """
    wall, cpu = work_clock(), cpu_seconds()
    result = function(*args, **kwargs)
    raised = max((peak_bytes() - REUSED.held_bytes) / MIB, REUSED.peak_mib)
    return result, Spent(work_clock() - wall, cpu_seconds() - cpu, raised)


@contextlib.contextmanager
def keep_results() -> Iterator[None]:
    """Keep the results of :func:`make_once` within the block, and use those that were kept in earlier blocks."""
    REUSED.active, REUSED.peak_mib, REUSED.held_bytes = True, 0.0, peak_bytes()
    try:
        yield
    finally:
        REUSED.active = False


def make_once(key: tuple[Any, ...], function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
    """Return what a function returns; in a block of :func:`keep_results`, an earlier result if there is one.

    Parameters
    ----------
    key
        All that the result depends on, with a word for what it is: :func:`leaves` that are arrays or have a ``repr``.
    function, args, kwargs
        The function and its arguments. The arrays of a result that is kept are read-only.
    """
    if not REUSED.active:
        return function(*args, **kwargs)
    digest = _hash_leaves(key)
    earlier = REUSED.kept.pop(digest, None)
    if earlier is None:
        result, spent = measure_cost(function, *args, **kwargs)
        earlier = freeze(result), spent
    else:
        REUSED.count(earlier[1])
    REUSED.kept[digest] = earlier
    while len(REUSED.kept) > MOST_KEPT:
        del REUSED.kept[next(iter(REUSED.kept))]
    found: R = earlier[0]
    return found


def _hash_leaves(thing: Any) -> bytes:
    digest = hashlib.blake2b()
    for part in leaves(thing):
        if isinstance(part, np.ndarray):
            digest.update(f"{part.dtype}{part.shape}".encode() + part.tobytes())
        else:
            digest.update(f"{part!r};".encode())
    return digest.digest()


def leaves(thing: Any) -> Iterator[Any]:
    """Yield the values that mappings, sequences and dataclasses are made of, and the names of the values."""
    if dataclasses.is_dataclass(thing) and not isinstance(thing, type):
        thing = {field.name: getattr(thing, field.name) for field in dataclasses.fields(thing) if field.init}
    if isinstance(thing, Mapping):
        for key in sorted(thing, key=str):
            yield str(key)
            yield from leaves(thing[key])
    elif isinstance(thing, tuple | list):
        for part in thing:
            yield from leaves(part)
    else:
        yield thing


def freeze(thing: R) -> R:
    """Make all arrays of a value read-only, and return it."""
    for part in leaves(thing):
        if isinstance(part, np.ndarray):
            part.setflags(write=False)
    return thing
