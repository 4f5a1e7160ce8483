"""Work for a whole run that plugins do: they say what they are, draw its textures, and write its reports.

Plugins that are not part of nrbench do it in guarded child processes.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nrbench import plugins
from nrbench.errors import BadInput
from nrbench.imaging.convert import Image
from nrbench.plugins.forms import Shape, Texture
from nrbench.running.guard import Limits
from nrbench.runs.records import Run
from nrbench.runs.store import CellFolder, Result
from nrbench.storage import temporary_folder, write_json
from nrbench.suites.cell import Recipe
from nrbench.suites.plan import Draw, Plan, make_plan
from nrbench.suites.suite import Suite

# The processes are imported by the functions that start one: plans of the datasets of nrbench need none.
if TYPE_CHECKING:
    from nrbench.running.supervisor import RequestRunner, Supervisor

LIMITS = Limits(120.0, 4096.0)
"""The limits of the drawing of one texture, where no others are given."""
IMPORT = Limits(60.0, 4096.0)
"""The limits of the import of a plugin that is asked what it is."""


@contextmanager
def guarded_plugins() -> Iterator[None]:
    """Let child processes import the plugins of others while the context lasts; see :func:`nrbench.plugins.asking`."""
    with ExitStack() as stack, plugins.asking(make_ask(stack)):
        yield


def make_ask(stack: ExitStack) -> plugins.Ask:
    """Return a function that asks child processes; they end with the stack."""
    started: list[Supervisor] = []
    turn = threading.Lock()

    def ask(question: Mapping[str, Any]) -> Any:
        from nrbench.running.supervisor import Supervisor

        with turn:
            if not started:
                started.append(stack.enter_context(Supervisor(warm=False)))
            return _answer(started[0], question)

    return ask


def _answer(runner: RequestRunner, question: Mapping[str, Any]) -> Any:
    """Return what a child process answers to a question about a plugin.

    Raises
    ------
    BadInput
        When it does not answer, with the cause.
    """
    result: Any = _run(runner, "describe", question, IMPORT)
    if result["status"] == "ok" and "facts" in result:
        return result["facts"]
    why = result["message"].partition("; raise")[0] or "ended without an answer"
    told = result["status"] == "refused" or "file" not in question
    raise BadInput(why if told else f"plugin {question['file']}: {why}")


def _run(runner: RequestRunner, phase: str, content: Mapping[str, Any], limits: Limits) -> Result:
    """Run a phase in a child process; ``cell.json`` of its folder has a content. Return how it ended."""
    from nrbench.running.worker import Request

    with _folder_of(content) as folder:
        return runner.run(Request(phase, str(folder), limits.seconds, limits.mib, plugins=plugins.files())).result


def plan_run(
    suite: Suite,
    textures: Sequence[str] = (),
    limits: Limits = LIMITS,
    progress: Callable[[float], None] = lambda done: None,
) -> Plan:
    """Draw every sample and list every cell, as :func:`~nrbench.suites.plan.make_plan` does.

    A dataset that fails, hangs or kills its process makes the cells of its texture fail, with the cause. The datasets
    of nrbench are drawn in this process.

    Parameters
    ----------
    suite, textures, progress
        See :func:`~nrbench.suites.plan.make_plan`.
    limits
        The limits of the drawing of one texture.
    """
    with ExitStack() as stack:
        started: list[Draw] = []

        def draw(recipe: Recipe, shape: Shape) -> tuple[Texture, Image | None]:
            if not started:
                from nrbench.running.supervisor import Supervisor

                started.append(guarded_draw(stack.enter_context(Supervisor(warm=False)), limits))
            return started[0](recipe, shape)

        return make_plan(suite, textures, draw, progress)


def write_guarded(run: Run, name: str, report: Any, folder: str | None, limits: Limits = LIMITS) -> Any:
    """Let a report plugin write its files in a child process, or return its text for a terminal.

    Parameters
    ----------
    run
        The run.
    name, report
        The name of the plugin, and an instance with its parameters.
    folder
        The folder of its files, below the run directory; None: it writes none and returns a text.
    limits
        The limits of the process.

    Returns
    -------
    list of str, or str
        The paths of its files, or the text.

    Raises
    ------
    RuntimeError
        When the plugin fails or kills its process; with the cause.
    """
    from nrbench.running.supervisor import Supervisor

    parameters, entry = plugins.parameters_of(report), "text" if folder is None else "written"
    wanted = {"run": str(run.root.resolve()), "report": name, "parameters": parameters, "folder": folder}
    with Supervisor(warm=False) as supervisor:
        result: Any = _run(supervisor, "write_report", wanted, limits)
    if result["status"] != "ok" or entry not in result:
        raise RuntimeError(result["message"] or "ended without an answer")
    return result[entry]


def guarded_draw(runner: RequestRunner, limits: Limits) -> Draw:
    """Return a function that draws a texture in a child process under limits, and raises BadInput if that fails.

    The error has the last lines that the dataset printed as a note.
    """
    from nrbench.running.phases import read_texture
    from nrbench.running.worker import Request

    def draw(recipe: Recipe, shape: Shape) -> tuple[Texture, Image | None]:
        with _folder_of({"recipe": recipe.as_dict(), "shape": list(shape)}) as folder:
            result = runner.run(
                Request("render", str(folder), limits.seconds, limits.mib, plugins=plugins.files())
            ).result
            if result["status"] != "ok" or "texture" not in result:
                cause = result["message"] or "ended without an answer"
                error = BadInput(cause if result["status"] == "invalid" else f"dataset {recipe.dataset}: {cause}")
                error.add_note(CellFolder(folder).log_tail())
                raise error
            return read_texture(folder, result["texture"])

    return draw


@contextmanager
def _folder_of(content: Mapping[str, Any]) -> Iterator[Path]:
    """Yield a temporary folder of a child process, whose ``cell.json`` has this content."""
    with temporary_folder() as folder:
        write_json(folder / "cell.json", content)
        yield folder
