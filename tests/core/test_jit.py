import os
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numba.core import sigutils

from nrbench import jit, work
from nrbench.cli import progress
from nrbench.jit import BoolView2, Float64x1, Float64x2, Int64x1, kernel
from nrbench.synthesizers.matching.matching_kernels import correlate_at


def double(x: float) -> float:
    """Return twice the argument."""
    return 2 * x


@jit.kernel
def squared(x: float) -> float:
    """Return the square."""
    return x * x


@jit.inlined_kernel
def added(x: float, y: float) -> float:
    """Return the sum."""
    return x + y


def sum_of_squares(x: float, y: float) -> float:
    """Return what two calls of a kernel give together."""
    return added(squared(x), squared(y))


def sum_of_powers(values: Float64x2) -> float:
    """Return a sum whose last bits depend on the order of its terms."""
    total = 0.0
    for row in range(values.shape[0]):
        for column in range(values.shape[1]):
            total += values[row, column] ** 3 / (1 + column)
    return total


@pytest.fixture
def undeclared(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Keep the kernels declared in a test from the others, and their machine code in a folder of the test."""
    monkeypatch.setattr(jit, "KERNELS", [])
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


@pytest.mark.usefixtures("undeclared")
def test_a_kernel_is_compiled_on_its_first_call_and_cached(tmp_path: Path) -> None:
    """A kernel is compiled when first called, gives what Python gives, and leaves its machine code in the cache."""
    kernel = jit.kernel(double)
    assert not list(tmp_path.rglob("*.bin"))
    assert kernel(3.0) == double(3.0)
    assert list(tmp_path.rglob("*.bin"))


@pytest.mark.usefixtures("undeclared")
def test_load_kernels_loads_every_declared_kernel() -> None:
    """After load_kernels nothing is left to compile."""
    kernel = jit.kernel(double)
    jit.load_kernels()
    assert kernel.load() is kernel.load()
    assert kernel.load() is not double


@pytest.fixture
def homeless(undeclared: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder of temporary files of a user whose cache cannot be written."""
    blocked, temporary = tmp_path / "file", tmp_path / "temporary"
    blocked.write_text("")
    temporary.mkdir()
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    monkeypatch.setattr(jit.tempfile, "tempdir", str(temporary))
    monkeypatch.setenv("MPLCONFIGDIR", "")  # so that it is put back
    monkeypatch.delenv("MPLCONFIGDIR")
    jit._writable.cache_clear()
    return temporary


def test_without_a_home_machine_code_is_temporary(homeless: Path) -> None:
    """One warning says so and what to set; the next process of the user reads the code, and has its own warning."""
    for hits in (0, 1):
        jit._writable.cache_clear()
        with pytest.warns(UserWarning, match=r"file/nrbench cannot be written .*set XDG_CACHE_HOME") as said:
            declared = jit.kernel(double)
            jit.load_kernels()
        assert declared(3.0) == 6.0 and (declared._dispatcher is None) == bool(hits)
        assert len(said) == 1 and len(list(homeless.rglob("*.bin"))) == 1
    (folder,) = homeless.iterdir()
    assert os.environ["MPLCONFIGDIR"] == str(folder)
    assert folder.stat().st_mode & 0o777 == 0o700


def test_a_user_without_any_home_has_temporary_machine_code(homeless: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the system lists no home for a user, and platformdirs raises, the same warning says so."""

    def fail(*names: object, **options: object) -> Path:
        raise RuntimeError("could not determine the home directory")

    monkeypatch.setattr(jit.platformdirs, "user_cache_path", fail)
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    with pytest.warns(UserWarning, match=r"the cache cannot be written \(there is no home directory\)"):
        assert jit.find_cache().parent == homeless


def test_machine_code_that_others_may_write_is_not_run(homeless: Path) -> None:
    """A folder of the expected name that others can write to is not used, nor one that is a link."""
    for made in (lambda name: name.mkdir(), lambda name: name.symlink_to(homeless.parent)):
        with pytest.warns(UserWarning, match="cannot be written"):
            expected = jit.find_cache()
        expected.rmdir()
        made(expected)
        if not expected.is_symlink():
            expected.chmod(0o777)
        jit._writable.cache_clear()
        with pytest.warns(UserWarning, match="cannot be written"):
            assert jit.find_cache() not in (expected, expected.resolve())
        for folder in homeless.iterdir():
            folder.unlink() if folder.is_symlink() else folder.rmdir()
        jit._writable.cache_clear()


def test_a_kernel_works_where_nothing_can_be_written(homeless: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is compiled in each process then, which says so once."""
    monkeypatch.setattr(jit.tempfile, "tempdir", str(homeless / "missing"))
    with pytest.warns(UserWarning, match="nor a temporary folder, so each process compiles them") as said:
        assert jit.kernel(double)(3.0) == jit.kernel(double)(3.0) == 6.0
    assert len(said) == 1


def test_time_of_compilation_is_named(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """The line of a long step names it, and does not count it; without such a line one notice is printed."""
    now = [100.0]
    monkeypatch.setattr(jit, "COMPILATION", spent := jit.Compilation())
    monkeypatch.setattr(jit.time, "monotonic", lambda: now[0])
    for _ in range(3):
        with spent.timed(), spent.timed():
            now[0] += 1.5
    assert spent.seconds == 4.5 and capsys.readouterr().err.splitlines() == [f"nrbench: {jit.COMPILING}"]
    spent.kernels += ["seam_kernels", "tile_kernels", "seam_kernels"]
    spent.report()
    assert capsys.readouterr().err == "nrbench: compiled 3 kernels (seam, tile) in 4 s\n"
    monkeypatch.undo()
    monkeypatch.setattr(jit, "COMPILATION", spent := jit.Compilation())
    monkeypatch.setattr(progress, "PATIENCE", 0.0)
    monkeypatch.setattr(progress, "PAUSE", 0.02)
    with progress.waiting("gncc looks"):
        with spent.timed():
            time.sleep(0.1)
        time.sleep(0.1)
    lines = capsys.readouterr().err.splitlines()
    assert any(line.startswith(jit.COMPILING) for line in lines) and lines[-1] == "gncc looks: 0 s"
    assert spent.ended >= 0.1
    monkeypatch.setattr(work, "COMPILATION", spent)
    before, cpu = work.work_clock(), work.cpu_seconds()
    with spent.timed():
        time.sleep(0.1)
    assert work.work_clock() - before < 0.1
    assert work.cpu_seconds() >= cpu, "a compilation that waits for the processor takes nothing off other work"


@pytest.mark.usefixtures("undeclared")
def test_a_kernel_may_call_a_kernel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A kernel is compiled with those it calls, inlined or not, gives what Python gives, and is read without those."""
    for link in (jit._link_kernels, None):
        monkeypatch.setattr(jit, "_link_kernels", link)
        assert jit.kernel(sum_of_squares)(3.0, 4.0) == 25.0
    (file,) = tmp_path.rglob("*.bin")
    assert str(file.relative_to(tmp_path / "nrbench")) == jit._code_name(sum_of_squares, jit._target())


@pytest.mark.usefixtures("undeclared")
def test_only_kernels_call_a_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A step is part of its callers' machine code and has none of its own, so a call from Python is an error."""
    step = jit.step_kernel(squared.function)
    monkeypatch.setitem(sum_of_squares.__globals__, "squared", step)
    assert jit.kernel(sum_of_squares)(3.0, 4.0) == 25.0
    with pytest.raises(TypeError, match="squared: only kernels call a step"):
        step(3.0)
    jit.load_kernels()
    assert len(list(tmp_path.rglob("*.bin"))) == 1


@pytest.mark.usefixtures("undeclared")
def test_the_user_is_told_before_kernels_are_compiled(tmp_path: Path) -> None:
    """Loading kernels says that it compiles them the first time, and not when it reads the cache."""
    said = []
    for _ in range(2):
        jit.KERNELS[:] = [jit.kernel(sum_of_squares)]
        jit.load_kernels(lambda: said.append(len(list(tmp_path.rglob("*.bin")))))
    assert said == [0]


def test_the_cache_follows_the_kernels_that_are_called(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Machine code is made anew for another numba or processor, and when only the file of a called kernel changes."""
    other = tmp_path / "other.py"
    other.write_text("first")
    (tmp_path / "_version.py").write_text("first")
    monkeypatch.setattr(jit, "_find_numba", lambda: tmp_path)
    monkeypatch.setattr(jit.inspect, "getfile", lambda f: str(other) if f is squared.function else __file__)
    names = {jit._code_name(sum_of_squares, target) for target in ("one", "other")}
    for changed in (other, tmp_path / "_version.py"):
        changed.write_text("second")
        jit._read_source.cache_clear()
        names.add(jit._code_name(sum_of_squares, "one"))
    jit._read_source.cache_clear()
    assert len(names) == 4


def test_compiled_and_plain_kernels_agree() -> None:
    """The border-matching kernel gives compiled what it gives as Python, to the last bit."""
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (12, 30, 3)).astype(np.float32)
    template = rng.integers(0, 256, (5, 3, 3)).astype(np.float32)
    hole = (1, 3, 0, 2)
    positions = np.array([[0, 0], [21, 7], [4, 3]])
    compiled = correlate_at(image, template, hole, positions)
    np.testing.assert_array_equal(compiled, correlate_at.function(image, template, hole, positions))


@kernel
def divide(x: Float64x1, y: float) -> Float64x1:
    """Return a quotient."""
    return x * (1.0 / y)


def test_arrays_of_another_type_are_refused() -> None:
    """Machine code would misread arrays of another type, so there is an error. Errors of kernels come through."""
    assert divide(np.ones(2), 2.0).tolist() == [0.5, 0.5]
    for wrong in (np.ones(2, np.int64), np.ones((2, 2)), np.ones(4)[::2]):
        with pytest.raises(TypeError, match="divide: the arguments"):
            divide(wrong, 2.0)
    with pytest.raises(ZeroDivisionError):
        divide(np.ones(2), 0.0)


@pytest.mark.usefixtures("undeclared")
def test_machine_code_of_a_wheel_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Machine code beside the module is loaded, but not on a processor that lacks its instructions."""
    shipped = tmp_path / jit._code_name(double, jit.SHIPPED_TARGET)
    shipped.parent.mkdir()
    assert jit.kernel(double)(3.0) == 6.0
    next(tmp_path.rglob("*.bin")).rename(shipped)
    monkeypatch.setattr(jit, "_SHIPPED", tmp_path)
    for runs in (True, False):
        monkeypatch.setattr(jit, "_runs_shipped", lambda runs=runs: runs)
        declared = jit.kernel(double)
        assert declared(3.0) == 6.0 and (declared._dispatcher is None) == runs


@pytest.mark.usefixtures("undeclared")
def test_machine_code_gives_what_numba_gives(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiled and read again, machine code gives numba's sums to the last bit. Numba is used where it has changed.

    Numba itself compiles as ever after a kernel was compiled, although both use the same functions.
    """
    values = np.random.default_rng(0).random((37, 41))
    made = [jit.kernel(sum_of_powers) for _ in range(5)]
    compiled = made[0](values)
    assert made[1].dispatcher()(values) == compiled
    assert made[2](values) == compiled and made[2]._dispatcher is None
    monkeypatch.delattr(jit.MachineCode, "link")
    for declared in made[3:]:
        with pytest.warns(UserWarning, match="this version of numba"):
            assert declared(values) == compiled
        monkeypatch.setattr(jit, "_read_code", lambda _: None)


@pytest.mark.usefixtures("undeclared")
def test_damaged_machine_code_is_compiled_again(tmp_path: Path) -> None:
    """Code that a full disk or a crash has cut or changed is never run, and is replaced."""
    assert jit.kernel(double)(3.0) == 6.0
    file = next(tmp_path.rglob("*.bin"))
    whole = file.read_bytes()
    for damaged in (b"", whole[: len(whole) // 2], whole[:-10], bytes(len(whole)), whole[:-99] + bytes(99)):
        file.write_bytes(damaged)
        assert jit.kernel(double)(3.0) == 6.0
        assert jit.MachineCode.from_bytes(file.read_bytes()).content


@pytest.mark.usefixtures("undeclared")
def test_threads_load_a_kernel_once() -> None:
    """Threads that call a kernel for the first time at once all get its answer, from one linked function."""
    shared = jit.kernel(double)
    with ThreadPoolExecutor(8) as pool:
        loaded = set(pool.map(lambda _: shared.load(), range(16)))
        assert set(pool.map(shared, [3.0] * 16)) == {6.0}
    assert len(loaded) == 1


@kernel
def fill(values: Float64x1, value: float) -> None:
    """Set all values."""
    values[:] = value


def test_a_kernel_does_not_write_read_only_arrays() -> None:
    """Machine code would write them, also where they are a file or the bytes of an object."""
    values = np.zeros(3)
    fill(values, 2.0)
    values.flags.writeable = False
    with pytest.raises(TypeError, match="fill: the arguments"):
        fill(values, 1.0)
    assert values.tolist() == [2.0, 2.0, 2.0]


def test_annotations_are_the_types_of_a_kernel() -> None:
    """Numba compiles a kernel for its annotations: scalars, contiguous arrays, views and tuples."""

    def count(a: Float64x2, b: BoolView2, c: bool, d: np.int32) -> tuple[Int64x1, float]:
        raise AssertionError  # only its annotations are read

    expected = "Tuple((int64[::1], float64,))(float64[:, ::1], boolean[:, :], boolean, int32)"
    signature = jit.find_signature(count)
    assert (signature.args, signature.return_type) == sigutils.normalize_signature(expected)


class Span(NamedTuple):
    """A record of two numbers."""

    start: int
    stop: float


@kernel
def measure_span(span: Span) -> float:
    """Return the length of a span."""
    return span.stop - span.start


def test_kernels_take_records() -> None:
    """A kernel takes a named tuple, whose fields have the types of its annotations."""
    assert measure_span(Span(2, 5.5)) == 3.5
