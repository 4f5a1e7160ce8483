"""Compiled kernels: numba where it is installed, plain Python with a warning where it is not.

The first call of a kernel, or :func:`load_kernels`, imports numba and compiles the kernel or reads it from the cache.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import inspect
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FunctionType
from typing import Any, Generic, ParamSpec, TypeVar

import platformdirs

P = ParamSpec("P")
R = TypeVar("R")

KERNELS: list[Kernel[..., Any]] = []
"""Every kernel declared so far."""


class Kernel(Generic[P, R]):
    """A function that numba compiles for one signature when it is first needed.

    Parameters
    ----------
    function
        Plain Python that numba can compile. It may call other kernels by their names in its module.
    signature
        The signature that numba compiles for, e.g. ``"float64(float64[::1])"``. No later call compiles another one.
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
        """Return the compiled function. The first call compiles it or reads it from the cache."""
        if self._compiled is None:
            self._compiled = _compile(self.function, self.signature)
        return self._compiled


def kernel(signature: str) -> Callable[[Callable[P, R]], Kernel[P, R]]:
    """Declare a function as a :class:`Kernel`."""

    def declare(function: Callable[P, R]) -> Kernel[P, R]:
        return Kernel(function, signature)

    return declare


def load_kernels(compiling: Callable[[], None] = lambda: None) -> None:
    """Load every declared kernel. A process calls this before it forks children that compute.

    Of several processes that find kernels uncompiled at the same time, one compiles them; the others wait for it and
    read the cache.

    Parameters
    ----------
    compiling
        Called if kernels have to be compiled, before that begins.
    """
    with contextlib.ExitStack() as stack:
        if any(map(_is_uncompiled, KERNELS)):
            compiling()
            stack.enter_context(_one_process_at_a_time())
        for declared in KERNELS:
            declared.load()


def _is_uncompiled(declared: Kernel[..., Any]) -> bool:
    """Return whether no kernel of a kernel's file is in nrbench's cache. Another cache of numba's is not searched."""
    try:
        numba: Any = importlib.import_module("numba")
    except ImportError:
        return False
    return not (numba.config.CACHE_DIR or cache_folder(declared.function, numba.__version__).is_dir())


@contextlib.contextmanager
def _one_process_at_a_time() -> Iterator[None]:
    """Hold a lock in the folder of the cache, where the system has such locks and the folder can be written."""
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(ImportError, OSError):
            import fcntl

            folder = platformdirs.user_cache_path("nrbench", appauthor=False)
            folder.mkdir(parents=True, exist_ok=True)
            fcntl.flock(stack.enter_context((folder / ".compiling").open("w")), fcntl.LOCK_EX)
        yield


def cache_folder(function: Callable[..., Any], version: str) -> Path:
    """Return the folder of a function's machine code, named by numba's version and a hash of the function's file.

    The hash includes the files of the kernels that the function calls, because they are compiled into it.
    """
    sources = [Path(inspect.getfile(each)) for each in (function, *_list_called(function))]
    texts = b"".join(source.read_bytes() for source in dict.fromkeys(sources))
    digest = hashlib.blake2b(texts, digest_size=8).hexdigest()
    return platformdirs.user_cache_path("nrbench", appauthor=False) / f"{sources[0].stem}-{digest}-numba-{version}"


def find_called_kernels(function: Callable[..., Any]) -> dict[str, Kernel[..., Any]]:
    """Return the kernels that a function calls, by their names in its code."""
    names = {name: function.__globals__.get(name) for name in function.__code__.co_names}
    return {name: found for name, found in names.items() if isinstance(found, Kernel)}


def _list_called(function: Callable[..., Any]) -> list[Callable[..., Any]]:
    """Return the functions of all kernels that a function calls, directly or not, callers first."""
    found: list[Callable[..., Any]] = []
    for called in find_called_kernels(function).values():
        found += [called.function, *_list_called(called.function)]
    return found


def _link_kernels(function: Callable[P, R]) -> Callable[P, R]:
    """Return the function with its kernels replaced by compiled functions, because numba cannot call kernels."""
    called = {name: each.load() for name, each in find_called_kernels(function).items()}
    if not called:
        return function
    linked = FunctionType(
        function.__code__, {**function.__globals__, **called}, function.__name__, function.__defaults__
    )
    linked.__module__, linked.__qualname__ = function.__module__, function.__qualname__
    return linked


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
    return _njit(numba, _link_kernels(function), signature, cache_folder(function, numba.__version__))


def _njit(numba: Any, function: Callable[P, R], signature: str, folder: Path) -> Callable[P, R]:
    # The folder is numba's global setting, read while it decorates. It is put back, so that the user's setting stays.
    # Reassociated sums use vector instructions. Results are equal on one type of machine. Across processors, kernels
    # that sum floats may differ in the last bit.
    before = numba.config.CACHE_DIR
    try:
        numba.config.CACHE_DIR = before or str(folder)
        compiled: Callable[P, R] = numba.njit(signature, cache=True, fastmath={"reassoc"})(function)
    except (RuntimeError, OSError):  # no folder to cache in
        compiled = numba.njit(signature, fastmath={"reassoc"})(function)
    finally:
        numba.config.CACHE_DIR = before
    return compiled
