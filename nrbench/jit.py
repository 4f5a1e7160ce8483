"""Kernels that numba compiles.

The first call of a kernel, or :func:`load_kernels`, imports numba and compiles the kernel or reads it from the cache.
The annotations of a kernel are the types that it is compiled for. ``Float64x2`` is an array of float64 with two
dimensions, contiguous in memory; a ``Float64View2`` need not be contiguous. A subclass of :class:`typing.NamedTuple` is
a record of several such values.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import inspect
import os
import stat
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Annotated, Any, Generic, ParamSpec, TypeVar, get_args, get_origin, get_type_hints

import numpy as np
import platformdirs
from numpy.typing import NDArray

P = ParamSpec("P")
R = TypeVar("R")

Float64x1 = Annotated[NDArray[np.float64], "float64[::1]"]
Float64x2 = Annotated[NDArray[np.float64], "float64[:, ::1]"]
Float64x3 = Annotated[NDArray[np.float64], "float64[:, :, ::1]"]
Float64x4 = Annotated[NDArray[np.float64], "float64[:, :, :, ::1]"]
Float64View2 = Annotated[NDArray[np.float64], "float64[:, :]"]
Float32x1 = Annotated[NDArray[np.float32], "float32[::1]"]
Float32x2 = Annotated[NDArray[np.float32], "float32[:, ::1]"]
Float32x3 = Annotated[NDArray[np.float32], "float32[:, :, ::1]"]
Float32x4 = Annotated[NDArray[np.float32], "float32[:, :, :, ::1]"]
Float32View2 = Annotated[NDArray[np.float32], "float32[:, :]"]
Float32View3 = Annotated[NDArray[np.float32], "float32[:, :, :]"]
Int64x1 = Annotated[NDArray[np.int64], "int64[::1]"]
Int64x2 = Annotated[NDArray[np.int64], "int64[:, ::1]"]
Int64x3 = Annotated[NDArray[np.int64], "int64[:, :, ::1]"]
Int32x1 = Annotated[NDArray[np.int32], "int32[::1]"]
Int32x2 = Annotated[NDArray[np.int32], "int32[:, ::1]"]
Int32x3 = Annotated[NDArray[np.int32], "int32[:, :, ::1]"]
Int16x1 = Annotated[NDArray[np.int16], "int16[::1]"]
Int16x2 = Annotated[NDArray[np.int16], "int16[:, ::1]"]
UInt8x1 = Annotated[NDArray[np.uint8], "uint8[::1]"]
UInt8x2 = Annotated[NDArray[np.uint8], "uint8[:, ::1]"]
UInt64x1 = Annotated[NDArray[np.uint64], "uint64[::1]"]
Float32View4 = Annotated[NDArray[np.float32], "float32[:, :, :, :]"]
UInt8View3 = Annotated[NDArray[np.uint8], "uint8[:, :, :]"]
Boolx1 = Annotated[NDArray[np.bool_], "boolean[::1]"]
Boolx2 = Annotated[NDArray[np.bool_], "boolean[:, ::1]"]
BoolView2 = Annotated[NDArray[np.bool_], "boolean[:, :]"]

_SCALARS: dict[Any, str] = {float: "float64", int: "int64", bool: "boolean", type(None): "void"}

KERNELS: list[Kernel[..., Any]] = []
"""Every kernel declared so far."""
COMPILING = "compiling kernels (once per machine, up to some minutes)"
"""The notice of a process that compiles kernels."""
_PATIENCE = 2.0
"""Seconds of compilation after which the notice is given."""


@dataclass
class Compilation:
    """How long this process has compiled kernels.

    Parameters
    ----------
    ended
        Seconds of the compilations that have ended.
    cpu
        Processor seconds of this process in the compilations that have ended.
    since
        When the present one began, of :func:`time.monotonic`; None if there is none.
    told
        Whether the user knows, so that no notice is printed.
    """

    ended: float = 0.0
    cpu: float = 0.0
    since: float | None = None
    told: bool = False

    @property
    def seconds(self) -> float:
        """Seconds of all compilations."""
        return self.ended + (0.0 if self.since is None else time.monotonic() - self.since)

    @contextlib.contextmanager
    def timed(self) -> Iterator[None]:
        """Measure a compilation, in which others may be nested; print a notice if all together take long."""
        if self.since is not None:
            yield
            return
        if self.ended > _PATIENCE and not self.told:
            self.told = True
            print(f"nrbench: {COMPILING}", file=sys.stderr, flush=True)
        self.since, cpu = time.monotonic(), time.process_time()
        try:
            yield
        finally:
            self.ended, self.since = self.seconds, None
            self.cpu += time.process_time() - cpu


COMPILATION = Compilation()
"""The compilation of this process."""


def work_clock() -> float:
    """Return :func:`time.perf_counter` without the seconds in which this process has compiled kernels."""
    return time.perf_counter() - COMPILATION.seconds


class Kernel(Generic[P, R]):
    """A function that numba compiles for the types of its annotations when it is first needed.

    Parameters
    ----------
    function
        Plain Python that numba can compile. It may call other kernels by their names in its module. No later call
        compiles it for other types.
    allocates
        Whether it may make arrays. If not, numba counts no references to its arguments, which saves about 0.2 us a call
        of a kernel with a dozen arrays.
    inlined
        Whether numba copies its code into the kernels that call it. They are then compiled as one loop.
    """

    def __init__(self, function: Callable[P, R], allocates: bool = True, inlined: bool = False) -> None:
        self.function, self.allocates, self.inlined = function, allocates, inlined
        self._compiled: Callable[P, R] | None = None
        KERNELS.append(self)

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Run the kernel."""
        return self.load()(*args, **kwargs)

    def load(self) -> Callable[P, R]:
        """Return the compiled function. The first call compiles it or reads it from the cache."""
        if self._compiled is None:
            self._compiled = _compile(self)
        return self._compiled


def kernel(function: Callable[P, R]) -> Kernel[P, R]:
    """Declare a function as a :class:`Kernel`."""
    return Kernel(function)


def step_kernel(function: Callable[P, R]) -> Kernel[P, R]:
    """Declare a function that makes no arrays as a :class:`Kernel`: a step of another kernel, which calls it often."""
    return Kernel(function, allocates=False)


def inlined_kernel(function: Callable[P, R]) -> Kernel[P, R]:
    """Declare a function as a :class:`Kernel` that is copied into each kernel that calls it: a part of its loop."""
    return Kernel(function, inlined=True)


def find_signature(function: Callable[..., Any]) -> Any:
    """Return the signature that numba compiles a function for, from its annotations."""
    numba: Any = importlib.import_module("numba")
    types = {name: _find_type(numba, hint) for name, hint in get_type_hints(function, include_extras=True).items()}
    return numba.core.typing.signature(types.pop("return"), *types.values())


def _find_type(numba: Any, hint: Any) -> Any:
    """Return numba's type of an annotation."""
    if hasattr(hint, "_fields"):
        fields = get_type_hints(hint, include_extras=True).values()
        return numba.types.BaseTuple.from_types([_find_type(numba, field) for field in fields], hint)
    if get_origin(hint) is tuple:
        return numba.types.BaseTuple.from_types([_find_type(numba, part) for part in get_args(hint)])
    name = get_args(hint)[1] if get_origin(hint) is Annotated else _SCALARS.get(hint, hint.__name__)
    return numba.core.sigutils.normalize_signature(f"({name},)")[0][0]


def load_kernels(compiling: Callable[[], None] = lambda: None) -> None:
    """Load every declared kernel. A process calls this before it forks children that compute.

    Processes that find kernels uncompiled at the same time share the work: each compiles the kernels of the files that
    no other has begun, then waits for those, and reads them from the cache.

    Parameters
    ----------
    compiling
        Called if kernels have to be compiled, before that begins.
    """
    if any(map(_is_uncompiled, KERNELS)):
        compiling()
    files: dict[str, list[Kernel[..., Any]]] = {}
    for declared in KERNELS:
        files.setdefault(declared.function.__module__, []).append(declared)
    for waits in (False, True):
        for name in list(files):
            with _lock(name, waits) as own:
                if own:
                    for declared in files.pop(name):
                        declared.load()


def _is_uncompiled(declared: Kernel[..., Any]) -> bool:
    """Return whether no kernel of a kernel's file is in nrbench's cache. Another cache of numba's is not searched."""
    numba: Any = importlib.import_module("numba")
    cached = numba.config.CACHE_DIR or cache_folder(declared.function, numba.__version__).is_dir()
    return not (cached or declared.inlined)


@contextlib.contextmanager
def _lock(name: str, waits: bool) -> Iterator[bool]:
    """Lock the kernels of a file for this process; yield whether it may load them, as where nothing can be locked."""
    with contextlib.ExitStack() as stack:
        own = True
        with contextlib.suppress(ImportError, OSError):
            import fcntl

            file = stack.enter_context((find_cache() / f".{name}.lock").open("w"))
            try:
                fcntl.flock(file, fcntl.LOCK_EX | (0 if waits else fcntl.LOCK_NB))
            except BlockingIOError:
                own = False
        yield own


def find_cache() -> Path:
    """Return the folder of all machine code: that of the user, or a temporary one, with a warning."""
    own = os.environ.get("NUMBA_CACHE_DIR")
    if own:
        return Path(own)
    try:
        usual = platformdirs.user_cache_path("nrbench", appauthor=False)
    except RuntimeError:  # a user without an entry in the system's list has no home at all
        usual = Path()
    return _writable(usual)


@cache
def _writable(usual: Path) -> Path:
    """Return a folder if it can be written to, else a temporary one of this user, which lasts as long as the system."""
    try:
        if not usual.is_absolute():  # a user without a home
            raise FileNotFoundError(None, "there is no home directory")
        usual.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=usual):
            return usual
    except OSError as error:
        why = error.strerror
    user = 0 if sys.platform == "win32" else os.getuid()
    folder = Path(tempfile.gettempdir()) / f"nrbench-{user}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()  # machine code is run, so nobody else may be able to write it
        shared = sys.platform != "win32" and found.st_mode & 0o022
        if shared or found.st_uid != user or not stat.S_ISDIR(found.st_mode):
            folder = Path(tempfile.mkdtemp(prefix="nrbench-"))
    except OSError:
        return usual
    os.environ.setdefault("MPLCONFIGDIR", str(folder))  # else matplotlib has two lines of its own about it
    warnings.warn(
        f"compiled kernels: {usual if usual.name else 'the cache'} cannot be written ({why}), so they are kept in "
        f"{folder}; set XDG_CACHE_HOME to a folder that lasts, else they may be compiled again, which takes up to some "
        "minutes",
        stacklevel=2,
    )
    return folder


def cache_folder(function: Callable[..., Any], version: str) -> Path:
    """Return the folder of a function's machine code, named by numba's version and a hash of the function's file.

    The hash includes the files of the kernels that the function calls, because they are compiled into it.
    """
    sources = [Path(inspect.getfile(each)) for each in (function, *_list_called(function))]
    texts = b"".join(source.read_bytes() for source in dict.fromkeys(sources))
    digest = hashlib.blake2b(texts, digest_size=8).hexdigest()
    return find_cache() / f"{sources[0].stem}-{digest}-numba-{version}"


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


def _compile(declared: Kernel[P, R]) -> Callable[P, R]:
    import numba

    function = declared.function
    if declared.inlined:  # compiled with its callers
        inlined: Callable[P, R] = numba.njit(inline="always")(_link_kernels(function))
        return inlined
    signature, folder = find_signature(function), cache_folder(function, numba.__version__)
    if any(folder.glob(f"*/*.{function.__qualname__}-*.nbi")):
        # The machine code in the cache includes that of the kernels it calls, which are not loaded then. Kernels are no
        # functions to numba: if it has to compile after all, as for another processor, it says so.
        with contextlib.suppress(numba.TypingError):
            return _njit(numba, function, signature, folder, declared.allocates)
    with COMPILATION.timed():
        return _njit(numba, _link_kernels(function), signature, folder, declared.allocates)


def _njit(numba: Any, function: Callable[P, R], signature: Any, folder: Path, allocates: bool) -> Callable[P, R]:
    # The folder is numba's global setting, read while it decorates. It is put back, so that the user's setting stays.
    # Reassociated sums use vector instructions. Results are equal on one type of machine. Across processors, kernels
    # that sum floats may differ in the last bit.
    before = numba.config.CACHE_DIR
    try:
        numba.config.CACHE_DIR = before or str(folder)
        compiled: Callable[P, R] = numba.njit(signature, cache=True, fastmath={"reassoc"}, _nrt=allocates)(function)
    except (RuntimeError, OSError):  # no folder to cache in
        compiled = numba.njit(signature, fastmath={"reassoc"}, _nrt=allocates)(function)
    finally:
        numba.config.CACHE_DIR = before
    return compiled
