"""A method that a notebook defines runs in its process, and says so."""

import importlib
import inspect
import subprocess
import sys
import textwrap
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

import nrbench
from nrbench import Options, Synthesis, Task, plugins
from nrbench.plugins import registry
from nrbench.running.supervisor import third_party

COMMON: dict[str, Any] = {"textures": "brick-mild", "size": "64x64", "metrics": ["cost"]}


@pytest.fixture(autouse=True)
def _fresh(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """No test registers a method for another one."""
    monkeypatch.setattr(registry, "_session", {})
    yield


def define(value: float) -> Any:
    """Return a new class, as a cell that is run again does."""

    @dataclass(frozen=True)
    class Mine:
        """Fills the output.

        Parameters
        ----------
        k
            A number.
        """

        k: float = 0.0
        name: ClassVar[str] = "mine"
        uses_lattice: ClassVar[bool] = False
        threads: ClassVar[list[Any]] = []

        def synthesize(self, task: Task) -> Synthesis:
            """Return one color."""
            self.threads.append(threading.current_thread())
            return Synthesis(np.full((*task.shape, 3), value + self.k, np.float32))

    return Mine


def test_a_class_of_a_notebook_runs_in_its_process_and_says_so(tmp_path: Path) -> None:
    """Instances and the class are methods beside others; each runs in the thread of the caller, others in workers.

    Its scores are those of the judge. The same class is not run again, and a new definition of it is.
    """
    told: list[str] = []
    options, mine = Options(jobs=1, tell=told.append), define(0.25)
    done = nrbench.run("core", methods=[mine(k=0.5), mine, "scatter"], out=tmp_path, options=options, **COMMON)
    assert [(one.method, one.status) for one in done.cells] == [(n, "ok") for n in ("mine:k=0.5", "mine", "scatter")]
    assert all(one.values["cost.seconds"] is not None for one in done.cells)
    assert mine.threads == [threading.current_thread()] * 2
    said = [line for line in told if "mine" in line]
    assert len(said) == 1 and "in this process without limits" in said[0] and "add_file" in said[0]
    images = [nrbench.read_image(one.folder / "output.png").flat[0] for one in done.cells[:2]]
    np.testing.assert_allclose(images, [0.75, 0.25], atol=1 / 255)
    nrbench.run("core", methods=[mine(k=0.5)], out=tmp_path, options=options, **COMMON)
    assert len(mine.threads) == 2
    again = nrbench.run("core", methods=define(0.125)(k=0.5), out=tmp_path, options=Options(jobs=0, tell=str), **COMMON)
    np.testing.assert_allclose(nrbench.read_image(again.cells[0].folder / "output.png"), 0.625, atol=1 / 255)
    assert third_party() == ([], [])


def test_what_cannot_run_is_one_clear_error(tmp_path: Path) -> None:
    """A class that is no method, or has the name of another one, is refused before anything runs; errors are cells."""
    with pytest.raises(nrbench.BadInput, match=r"method 'Path'.*dataclass"):
        nrbench.run("core", methods=[Path], out=tmp_path / "a", **COMMON)
    taken = define(0.5)
    taken.name = "rsgf"
    with pytest.raises(nrbench.BadInput, match="the name 'rsgf' is taken; give the class another `name`"):
        nrbench.run("core", methods=[taken()], out=tmp_path / "a", **COMMON)
    assert not (tmp_path / "a").exists()
    broken = define(0.5)
    broken.synthesize = lambda self, task: 1 / 0
    done = nrbench.run("core", methods=broken, out=tmp_path / "b", options=Options(jobs=1, tell=str), **COMMON)
    assert done.cells[0].status == "error" and "ZeroDivisionError" in done.cells[0].message


def test_a_class_of_a_loaded_file_has_limits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Imported as a module, it is the method that was loaded from its file, and runs in a child process."""
    text = inspect.getsource(define).partition("    @dataclass")[2].partition("    return Mine")[0]
    head = "from dataclasses import dataclass\nfrom nrbench import *\nfrom typing import Any, ClassVar\nvalue = 0.5\n"
    (tmp_path / "own_cell.py").write_text(head + textwrap.dedent("    @dataclass" + text).replace('"mine"', '"own"'))
    monkeypatch.syspath_prepend(tmp_path)
    plugins.add_file("own_cell.py")
    mine = importlib.import_module("own_cell").Mine
    assert plugins.add_method(mine) == "own" and not plugins.lookup("synthesizers", "own").in_session
    table = nrbench.plan("core", methods=[mine(k=0.25)], textures="brick-mild")
    assert list(table["method"]) == ["own:k=0.25"]


def test_a_class_that_moves_to_a_file_keeps_its_name(tmp_path: Path) -> None:
    """A method of the session gives way to that of the same name in a file that is loaded later."""
    (tmp_path / "moved.py").write_text(
        "from dataclasses import dataclass\n@dataclass(frozen=True)\nclass Moved:\n"
        '    """Nothing."""\n    name = "mine"\n    def synthesize(self, task):\n        """Fail."""\n'
    )
    plugins.add_method(define(0.5))
    assert plugins.lookup("synthesizers", "mine").in_session
    plugins.add_file(tmp_path / "moved.py")
    assert plugins.lookup("synthesizers", "mine").in_file and not plugins.lookup("synthesizers", "mine").in_session
    registry._files.pop((tmp_path / "moved.py").resolve())


def test_the_function_that_the_message_names_is_there() -> None:
    """``import nrbench`` alone gives nrbench.plugins.add_file."""
    program = "import nrbench; print(nrbench.plugins.add_file.__name__)"
    assert subprocess.check_output([sys.executable, "-c", program], text=True) == "add_file\n"
    assert nrbench.plugins is plugins
