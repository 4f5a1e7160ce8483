from pathlib import Path
from typing import NamedTuple

import numba
import numpy as np
import pytest
from numba.core import sigutils

from nrbench import jit
from nrbench.jit import BoolView2, Float64x2, Int64x1, kernel
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


@pytest.fixture
def undeclared(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Keep the kernels declared in a test from the others, and their machine code in a folder of the test."""
    monkeypatch.setattr(jit, "KERNELS", [])
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


@pytest.mark.usefixtures("undeclared")
def test_a_kernel_is_compiled_on_its_first_call_and_cached(tmp_path: Path) -> None:
    """A kernel is compiled when first called, gives what Python gives, and leaves its machine code in the cache.

    The cache of the user's own numba functions does not move.
    """
    kernel, before = jit.kernel(double), numba.config.CACHE_DIR
    assert not list(tmp_path.rglob("*.nbi"))
    assert kernel(3.0) == double(3.0)
    assert list(tmp_path.rglob("*.nbi"))
    assert before == numba.config.CACHE_DIR


@pytest.mark.usefixtures("undeclared")
def test_load_kernels_loads_every_declared_kernel() -> None:
    """After load_kernels nothing is left to compile."""
    kernel = jit.kernel(double)
    jit.load_kernels()
    assert kernel.load() is kernel.load()
    assert kernel.load() is not double


@pytest.mark.usefixtures("undeclared")
def test_a_cache_that_cannot_be_written_is_done_without(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A kernel works where no folder can be written to."""
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    assert jit.kernel(double)(3.0) == 6.0


@pytest.mark.usefixtures("undeclared")
def test_a_kernel_may_call_a_kernel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A kernel is compiled with those it calls, inlined or not, and gives what Python gives.

    It is read from the cache without those. If a part of the cache is lost, it is compiled with them again.
    """
    folder = jit.cache_folder(sum_of_squares, numba.__version__)
    for link in (jit._link_kernels, None, jit._link_kernels):
        monkeypatch.setattr(jit, "_link_kernels", link)
        compiled = jit.kernel(sum_of_squares).load()
        assert compiled(3.0, 4.0) == 25.0
        assert bool(compiled.stats.cache_hits) == (link is None)  # type: ignore[attr-defined]
        assert Path(compiled.stats.cache_path).parent == folder  # type: ignore[attr-defined]
        for file in tmp_path.rglob("*.nbc") if link is None else ():
            file.unlink()


@pytest.mark.usefixtures("undeclared")
def test_the_user_is_told_before_kernels_are_compiled(tmp_path: Path) -> None:
    """Loading kernels says that it compiles them the first time, and not when it reads the cache."""
    said = []
    for _ in range(2):
        jit.KERNELS[:] = [jit.kernel(sum_of_squares)]
        jit.load_kernels(lambda: said.append(len(list(tmp_path.rglob("*.nbi")))))
    assert said == [0]


def test_the_cache_follows_the_kernels_that_are_called(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Machine code is made anew for another numba, and when only the text of a called kernel's file changes."""
    other = tmp_path / "other.py"
    other.write_text("first")
    monkeypatch.setattr(jit.inspect, "getfile", lambda f: str(other) if f is squared.function else __file__)
    before = jit.cache_folder(sum_of_squares, "1.0")
    assert jit.cache_folder(sum_of_squares, "2.0") != before
    other.write_text("second")
    assert jit.cache_folder(sum_of_squares, "1.0") != before


def test_compiled_and_plain_kernels_agree() -> None:
    """The border-matching kernel gives compiled what it gives as Python, to the last bit."""
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (12, 30, 3)).astype(np.float32)
    template = rng.integers(0, 256, (5, 3, 3)).astype(np.float32)
    hole = (1, 3, 0, 2)
    positions = np.array([[0, 0], [21, 7], [4, 3]])
    compiled = correlate_at(image, template, hole, positions)
    np.testing.assert_array_equal(compiled, correlate_at.function(image, template, hole, positions))


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
