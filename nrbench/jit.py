"""Kernels that numba compiles.

The first call of a kernel, or :func:`load_kernels`, reads its machine code from the folder ``machine_code`` beside this
file, which a binary wheel fills, or from the user's cache. Where neither has it, numba compiles the kernel. Importing
numba takes much longer than loading machine code, so a process that compiles nothing does not import it: LLVM links the
code with the C functions of numba's extension modules.

The annotations of a kernel are the types that it is compiled for. ``Float64x2`` is an array of float64 with two
dimensions, contiguous in memory; a ``Float64View2`` need not be contiguous. A subclass of :class:`typing.NamedTuple` is
a record of several such values.
"""

from __future__ import annotations

import atexit
import builtins
import contextlib
import ctypes
import gc
import hashlib
import importlib
import importlib.util
import inspect
import json
import os
import pkgutil
import stat
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from types import FunctionType
from typing import Annotated, Any, Generic, ParamSpec, TypeVar, get_args, get_origin, get_type_hints

import numpy as np
import platformdirs
from numpy.typing import NDArray

from nrbench.storage import write_bytes

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
SHIPPED_TARGET = "x86-64-v3 "
"""The processor that the machine code of a binary wheel is compiled for."""
_SHIPPED = Path(__file__).parent / "machine_code"
_LOADING = threading.RLock()
_ENVIRONMENTS: list[Any] = []
"""The environments of all machine code that was linked. The code points at them as long as the process lasts."""
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
    kernels
        The kernels that were compiled, by the names of their modules.
    """

    ended: float = 0.0
    cpu: float = 0.0
    since: float | None = None
    told: bool = False
    kernels: list[str] = field(default_factory=list)

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
        collects = gc.isenabled()
        gc.disable()  # an eighth of the time of numba, which keeps what it makes
        try:
            yield
        finally:
            if collects:
                gc.enable()
            self.ended, self.since = self.seconds, None
            self.cpu += time.process_time() - cpu

    def report(self) -> None:
        """Print what was compiled, and how long it took, if it took long."""
        if self.ended > _PATIENCE:
            modules = ", ".join(sorted({name.removesuffix("_kernels") for name in self.kernels}))
            count = f"{len(self.kernels)} kernel{'s' * (len(self.kernels) != 1)}"
            print(f"nrbench: compiled {count} ({modules}) in {self.ended:.0f} s", file=sys.stderr)


COMPILATION = Compilation()
"""The compilation of this process."""
atexit.register(lambda: COMPILATION.report())


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
    step
        Whether only other kernels call it. It then has no machine code but theirs.
    """

    def __init__(
        self, function: Callable[P, R], allocates: bool = True, inlined: bool = False, step: bool = False
    ) -> None:
        self.function, self.allocates, self.inlined, self.step = function, allocates, inlined, step
        self._loaded: Callable[P, R] | None = None
        self._dispatcher: Any = None
        KERNELS.append(self)

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Run the kernel. All arguments are given by position.

        Raises
        ------
        TypeError
            If an array has another type than the kernel is compiled for, or is read-only and the kernel returns
            nothing but what it writes; if the kernel is a step of others.
        """
        return (self._loaded or self.load())(*args, **kwargs)

    def load(self) -> Callable[P, R]:
        """Return the compiled function. The first call reads its machine code or compiles it."""
        with _LOADING:
            return self._load()

    def _load(self) -> Callable[P, R]:
        if self._loaded is None:
            if os.environ.get("NUMBA_DISABLE_JIT", "0") != "0":
                self._loaded = self.function
            elif self.step:
                raise TypeError(f"{self.function.__qualname__}: only kernels call a step")
            else:
                try:
                    self._loaded = _check_types(self.function, (_read_code(self) or self._compile()).link())
                except (AttributeError, ImportError, StopIteration, TypeError):  # a version of numba whose parts differ
                    warnings.warn(
                        "compiled kernels: this version of numba keeps machine code in another way, so each process "
                        "compiles them, which takes up to some minutes; install numba 0.68",
                        stacklevel=2,
                    )
                    for declared in KERNELS:
                        declared._dispatcher = None  # compiled without machine code
                    self._loaded = self.dispatcher()
        return self._loaded

    def dispatcher(self) -> Any:
        """Return numba's form of the function, compiled in this process, for kernels that call it."""
        if self._dispatcher is None:
            numba: Any = importlib.import_module("numba")
            linked = _link_kernels(self.function)
            if self.inlined:  # compiled with its callers
                self._dispatcher = numba.njit(inline="always")(linked)
            else:
                # Reassociated sums use vector instructions. Results are equal on one type of machine. Across
                # processors, kernels that sum floats may differ in the last bit.
                signature = find_signature(self.function)
                options = {"fastmath": {"reassoc"}, "_nrt": self.allocates, "no_cfunc_wrapper": True}
                options["no_cpython_wrapper"] = self.step
                self._dispatcher = numba.njit(signature, **options)(linked)
        return self._dispatcher

    def _compile(self) -> MachineCode:
        """Compile the kernel, and keep its machine code in the user's cache."""
        with COMPILATION.timed(), _without_linking():
            (compiled,) = self.dispatcher().overloads.values()
            code = MachineCode.of_compiled(compiled)
        COMPILATION.kernels.append(self.function.__module__.rpartition(".")[2])
        with contextlib.suppress(OSError):  # without a cache, each process compiles it
            write_bytes(find_cache() / _code_name(self.function, _target()), code.to_bytes())
        return code


def kernel(function: Callable[P, R]) -> Kernel[P, R]:
    """Declare a function as a :class:`Kernel`."""
    return Kernel(function)


def nonallocating_kernel(function: Callable[P, R]) -> Kernel[P, R]:
    """Declare a function that makes no arrays as a :class:`Kernel`, whose arguments numba then counts no references to.

    With records of arrays this matters: counted at each step, a search for nearest patches takes twice as long or more.
    """
    return Kernel(function, allocates=False)


def step_kernel(function: Callable[P, R]) -> Kernel[P, R]:
    """Declare a function that makes no arrays as a :class:`Kernel`: a step of other kernels, which alone call it."""
    return Kernel(function, allocates=False, step=True)


def allocating_step_kernel(function: Callable[P, R]) -> Kernel[P, R]:
    """Declare a function that may make arrays as a :class:`Kernel`: a step of other kernels, which alone call it."""
    return Kernel(function, step=True)


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
    needed = [declared for declared in KERNELS if not (declared.inlined or declared.step)]
    if not all(map(_find_code, needed)):
        compiling()
    files: dict[str, list[Kernel[..., Any]]] = {}
    for declared in needed:
        files.setdefault(declared.function.__module__, []).append(declared)
    by_length = sorted(files, key=lambda name: -len(inspect.getsource(sys.modules[name])))  # so that all end together
    for waits in (False, True):
        for name in filter(files.__contains__, by_length):
            with _lock(name, waits) as own:
                if own:
                    for declared in files.pop(name):
                        declared.load()


@contextlib.contextmanager
def _without_linking() -> Iterator[None]:
    """Let numba optimize what it compiles, but make no machine code: it would for each function that a kernel calls."""
    module: Any = importlib.import_module("numba.core.cpu")
    context, library = module.CPUContext, importlib.import_module("numba.core.codegen").JITCodeLibrary

    def stand_in(_: Any, library: Any, description: Any, environment: Any) -> Any:
        library._ensure_finalized()
        return module._dynfunc.make_function(sys, description.qualname, "", 0, environment, (library,))

    def finalize(library: Any) -> None:
        library._finalized = True

    def optimize(library: Any, module: Any) -> None:
        module.data_layout = library.codegen._data_layout
        passes, builder = library.codegen._function_pass_manager()  # numba makes one for each declaration
        for function in module.functions:
            if not function.is_declaration:
                passes.run(function, builder)

    lock = importlib.import_module("numba.core.compiler_lock").global_compiler_lock
    with lock:  # another thread may compile a function of its own
        replaced = context.get_executable, library._finalize_final_module, library._optimize_functions
        context.get_executable, library._finalize_final_module = stand_in, finalize
        library._optimize_functions = optimize
        try:
            yield
        finally:
            context.get_executable, library._finalize_final_module, library._optimize_functions = replaced


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
        with contextlib.suppress(OSError):
            Path(own).mkdir(parents=True, exist_ok=True)
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
        place = (
            f"so they are kept in {folder}; set XDG_CACHE_HOME to a folder that lasts, else they may be compiled again"
        )
    except OSError:
        folder, place = usual, "nor a temporary folder, so each process compiles them"
    os.environ.setdefault("MPLCONFIGDIR", str(folder))  # else matplotlib has two lines of its own about it
    warnings.warn(
        f"compiled kernels: {usual if usual.name else 'the cache'} cannot be written ({why}), {place}, which takes up "
        "to some minutes",
        stacklevel=2,
    )
    return folder


@dataclass(frozen=True)
class MachineCode:
    """The machine code of a kernel.

    Parameters
    ----------
    content
        An object file.
    wrapper, environment
        Its symbols for the function that Python calls, and for a pointer to numba's environment.
    constants
        The Python objects of the environment, in order: types of arrays as numpy writes them, and classes of records as
        ``module:name``.
    needed
        The C functions that it calls.
    """

    content: bytes
    wrapper: str
    environment: str
    constants: tuple[str, ...]
    needed: tuple[str, ...]

    @classmethod
    def of_compiled(cls, compiled: Any) -> MachineCode:
        """Return the machine code of what numba has compiled."""
        constants = tuple(
            each.str if isinstance(each, np.dtype) else f"{each.__module__}:{each.__qualname__}"
            for each in compiled.environment.consts
        )
        functions = compiled.library._final_module.functions
        needed = tuple(each.name for each in functions if each.is_declaration and not each.name.startswith("llvm."))
        description, codegen = compiled.fndesc, compiled.library.codegen
        content = codegen._tm.emit_object(compiled.library._final_module)
        return cls(content, description.llvm_cpython_wrapper_name, description.env_name, constants, needed)

    @classmethod
    def from_bytes(cls, content: bytes) -> MachineCode:
        """Return what :meth:`to_bytes` has written; a ValueError says that it is damaged."""
        head, _, code = content.partition(b"\n")
        wrapper, environment, constants, needed, digest = json.loads(head)
        if digest != hashlib.blake2b(code).hexdigest():
            raise ValueError("damaged machine code")
        return cls(code, wrapper, environment, tuple(constants), tuple(needed))

    def to_bytes(self) -> bytes:
        """Return a line of JSON, with a hash of the object file, and the object file."""
        digest = hashlib.blake2b(self.content).hexdigest()
        head = (self.wrapper, self.environment, self.constants, self.needed, digest)
        return json.dumps(head).encode() + b"\n" + self.content

    def is_complete(self) -> bool:
        """Return whether this process has all C functions that the code calls; LLVM ends a process that lacks one."""
        llvm, *_ = _linker()
        return all(map(llvm.address_of_symbol, self.needed))

    def link(self) -> Callable[..., Any]:
        """Return the function, which takes arguments by position."""
        llvm, engine, functions = _linker()
        engine.add_object_file(llvm.ObjectFileRef.from_data(self.content))
        engine.finalize_object()
        environment = functions.Environment({})
        environment.consts.extend(
            pkgutil.resolve_name(each) if ":" in each else np.dtype(each) for each in self.constants
        )
        _ENVIRONMENTS.append(environment)
        pointer = engine.get_global_value_address(self.environment)
        ctypes.c_void_p.from_address(pointer).value = id(environment)
        address = engine.get_function_address(self.wrapper)
        linked: Callable[..., Any] = functions.make_function(sys, self.wrapper, "", address, environment, (engine,))
        return linked


def _restore(address: int, size: int, digest: int) -> object:
    """Return an object that machine code holds pickled: the class of the arrays that it returns, or an error."""
    content = ctypes.string_at(address, size)
    if content.endswith(b"\x8c\x07ndarray\x94\x93\x94."):
        return np.ndarray
    serialize: Any = importlib.import_module("numba.core.serialize")
    return serialize._numba_unpickle(address, content, ctypes.string_at(digest, 20))


_RESTORE: Any = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.c_int, ctypes.c_void_p)(_restore)


@cache
def _linker() -> tuple[Any, Any, Any]:
    """Return LLVM, an engine that links machine code, and the module of numba's functions and environments.

    LLVM gets the names that :mod:`numba` gives it, without importing that package.
    """
    llvm: Any = importlib.import_module("llvmlite.binding")
    helpers, functions, arrays = map(_import_extension, ("_helperlib", "_dynfunc", "core/runtime/_nrt_python"))
    arrays.memsys_use_cpython_allocator()
    symbols = {f"numba_{name}": address for part in (helpers, functions) for name, address in part.c_helpers.items()}
    symbols |= {name if name[0] == "_" else f"NRT_{name}": each for name, each in arrays.c_helpers.items()}
    symbols |= {f"PyExc_{name}": id(each) for name, each in vars(builtins).items() if isinstance(each, type)}
    symbols |= {"_Py_NoneStruct": id(None), "numba_unpickle": ctypes.cast(_RESTORE, ctypes.c_void_p).value or 0}
    for name, address in symbols.items():
        llvm.add_symbol(name, address)
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_triple(llvm.get_process_triple()).create_target_machine()
    return llvm, llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine), functions


@cache
def _find_numba() -> Path:
    """Return the folder of numba, which is not imported."""
    found = importlib.util.find_spec("numba")
    assert found is not None and found.origin is not None
    return Path(found.origin).parent


def _import_extension(name: str) -> Any:
    """Import an extension module of numba without the package."""
    file = next(file for suffix in EXTENSION_SUFFIXES if (file := _find_numba() / f"{name}{suffix}").is_file())
    spec = importlib.util.spec_from_file_location(f"numba_only.{Path(name).name}", file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _read_code(declared: Kernel[..., Any]) -> MachineCode | None:
    """Return a kernel's machine code from the wheel or from the user's cache; None if it has to be compiled."""
    file = _find_code(declared)
    if file is None:
        return None
    try:
        code = MachineCode.from_bytes(file.read_bytes())
    except (OSError, ValueError):  # it is damaged
        return None
    return code if code.is_complete() else None


def _find_code(declared: Kernel[..., Any]) -> Path | None:
    """Return the file of a kernel's machine code, if there is one."""
    shipped = _SHIPPED / _code_name(declared.function, SHIPPED_TARGET)
    if shipped.is_file() and _runs_shipped():
        return shipped
    cached = find_cache() / _code_name(declared.function, _target())
    return cached if cached.is_file() else None


@cache
def _target() -> str:
    """Return the processor that numba compiles for, as its settings say: this one, unless another is set."""
    llvm: Any = importlib.import_module("llvmlite.binding")
    name, features = os.environ.get("NUMBA_CPU_NAME"), os.environ.get("NUMBA_CPU_FEATURES")
    name = llvm.get_host_cpu_name() if name is None else name
    return f"{name} {llvm.get_host_cpu_features().flatten() if features is None else features}"


@cache
def _runs_shipped() -> bool:
    """Return whether this processor has the instructions of :data:`SHIPPED_TARGET`."""
    llvm: Any = importlib.import_module("llvmlite.binding")
    features = llvm.get_host_cpu_features()
    return all(features.get(each) for each in ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe"))


def _code_name(function: Callable[..., Any], target: str) -> str:
    """Return the name of a function's machine code: of its file, a hash of all that the code depends on, and its own.

    These are the files of the function and of the kernels that it calls, which are compiled into it, this file, the
    versions of Python and numba, and the processor.
    """
    sources = [inspect.getfile(each) for each in (function, *_list_called(function))]
    texts = b"".join(map(_read_source, dict.fromkeys((*sources, __file__, str(_find_numba() / "_version.py")))))
    digest = hashlib.blake2b(texts + f"{sys.implementation.cache_tag} {target}".encode(), digest_size=8).hexdigest()
    return f"{Path(sources[0]).stem}-{digest}/{function.__qualname__}.bin"


@cache
def _read_source(file: str) -> bytes:
    return Path(file).read_bytes()


def _check_types(function: Callable[P, R], compiled: Callable[P, R]) -> Callable[P, R]:
    """Return the compiled function with a check of its arrays, because machine code would misread others."""
    hints = get_type_hints(function, include_extras=True)
    layouts = [_find_layout(hint) for name, hint in hints.items() if name != "return"]
    writes = hints["return"] is type(None)

    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        if not _fits(args, layouts, writes):
            raise TypeError(f"{function.__qualname__}: the arguments do not have the types of its annotations")
        return compiled(*args, **kwargs)

    return run


def _find_layout(hint: Any) -> Any:
    """Return what a hint says of arrays: type, dimensions and whether contiguous; a list for a tuple; else None."""
    if hasattr(hint, "_fields"):
        return [_find_layout(field) for field in get_type_hints(hint, include_extras=True).values()]
    if get_origin(hint) is tuple:
        return [_find_layout(part) for part in get_args(hint)]
    if get_origin(hint) is not Annotated:
        return None
    name, _, axes = get_args(hint)[1].partition("[")
    return np.dtype(name.replace("boolean", "bool")), axes.count(":") - axes.count("::"), "::1" in axes


def _fits(values: Iterable[Any], layouts: Iterable[Any], writes: bool) -> bool:
    """Return whether all arrays have their layouts, and can be written if the kernel ``writes``."""
    for value, layout in zip(values, layouts, strict=True):
        if type(layout) is list:
            if not _fits(value, layout, writes):
                return False
        elif layout is not None:
            dtype, dimensions, contiguous = layout
            if value.dtype != dtype or value.ndim != dimensions or (contiguous and not value.flags.c_contiguous):
                return False
            if writes and not value.flags.writeable:
                return False
    return True


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
    """Return the function with its kernels replaced by numba's forms of them, because numba cannot call kernels."""
    called = {name: each.dispatcher() for name, each in find_called_kernels(function).items()}
    if not called:
        return function
    linked = FunctionType(
        function.__code__, {**function.__globals__, **called}, function.__name__, function.__defaults__
    )
    linked.__module__, linked.__qualname__ = function.__module__, function.__qualname__
    return linked
