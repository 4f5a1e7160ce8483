"""Compiled kernels: numba where it is installed, plain Python with a warning where it is not.

numba is imported, and a kernel compiled or read from the cache, on the kernel's first call or :func:`load_kernels`.
"""

from __future__ import annotations

import hashlib
import inspect
import os
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, Generic, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")

KERNELS: list[Kernel[..., Any]] = []
"""Every kernel declared so far."""


class Kernel(Generic[P, R]):
    """A function that numba compiles for one signature when it is first needed.

    Parameters
    ----------
    function
        Plain Python that numba can compile. It calls no other kernel.
    signature
        numba's, e.g. ``"float64(float64[::1])"``: one machine code, and no compilation hidden in a later call.
    """

    def __init__(self, function: Callable[P, R], signature: str) -> None:
        self.function = function
        self.signature = signature
        self._compiled: Callable[P, R] | None = None
        KERNELS.append(self)

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Run the kernel."""
        return self.load()(*args, **kwargs)

    def load(self) -> Callable[P, R]:
        """Return the compiled function, compiling it or reading it from the cache on the first call."""
        if self._compiled is None:
            self._compiled = _compile(self.function, self.signature)
        return self._compiled


def kernel(signature: str) -> Callable[[Callable[P, R]], Kernel[P, R]]:
    """Declare a function as a :class:`Kernel`."""

    def declare(function: Callable[P, R]) -> Kernel[P, R]:
        return Kernel(function, signature)

    return declare


def load_kernels() -> None:
    """Load every declared kernel: what a process does before it forks children that compute."""
    for declared in KERNELS:
        declared.load()


def cache_folder(function: Callable[..., Any], version: str) -> Path:
    """Return where a function's machine code is kept: a user folder keyed by its file's text and numba's version."""
    source = Path(inspect.getfile(function))
    digest = hashlib.blake2b(source.read_bytes(), digest_size=8).hexdigest()
    return _user_cache() / "nrbench" / f"{source.stem}-{digest}-numba-{version}"


def _user_cache() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def _compile(function: Callable[P, R], signature: str) -> Callable[P, R]:
    try:
        import numba
    except ImportError:
        warnings.warn(
            f"numba is not installed: {function.__name__} runs uncompiled, hundreds of times slower; pip install numba",
            RuntimeWarning,
            stacklevel=3,
        )
        return function
    return _njit(numba, function, signature)


def _njit(numba: Any, function: Callable[P, R], signature: str) -> Callable[P, R]:
    # The folder is numba's global setting, read while it decorates: put back, so that the user's own stays his.
    # Reassociated sums use vector instructions; kernels sum whole numbers, so that their order changes no bit.
    before = numba.config.CACHE_DIR
    try:
        numba.config.CACHE_DIR = before or str(cache_folder(function, numba.__version__))
        compiled: Callable[P, R] = numba.njit(signature, cache=True, fastmath={"reassoc"})(function)
    except (RuntimeError, OSError):  # no folder to cache in
        compiled = numba.njit(signature, fastmath={"reassoc"})(function)
    finally:
        numba.config.CACHE_DIR = before
    return compiled
