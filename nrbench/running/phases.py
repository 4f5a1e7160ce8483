"""What the first of a cell's two children does: synthesize, and write what came out."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

from nrbench import plugins
from nrbench.imaging.files import read_image, write_image
from nrbench.plugins.forms import Again, Refused, Shape, Synthesis, Task, Texture, timed_detection
from nrbench.running.guard import cpu_seconds
from nrbench.running.outputs import InvalidOutput, checked_synthesis, is_picture
from nrbench.runs.store import CellFolder, read_json, write_arrays
from nrbench.streams import pixels_hash, stream
from nrbench.suites.cell import Cell

Send = Callable[[dict[str, Any]], None]
"""Sends one message to the process that watches this one."""


def synthesize(folder: Path, send: Send) -> None:
    """Run a cell's method and write what it made.

    Sends one message: status ``ok``, ``refused``, ``invalid``, ``memory`` or ``error``, with message and costs.
    """
    where = CellFolder(folder)
    cell = read_cell(where)
    try:
        send(_synthesize(where, cell))
    except Refused as refusal:
        send({"status": "refused", "message": refusal.reason})
    except InvalidOutput as invalid:
        send({"status": "invalid", "message": str(invalid)})
    except MemoryError:
        send({"status": "memory", "message": "ran out of the memory it may use"})
    except (Exception, SystemExit) as error:
        traceback.print_exc()
        send({"status": "error", "message": f"{type(error).__name__}: {error}"})


def _synthesize(where: CellFolder, cell: Cell) -> dict[str, Any]:
    method = plugins.build("synthesizers", cell.method, cell.parameters)
    task = _task(where, cell)
    wall, cpu = time.perf_counter(), cpu_seconds()
    made = method.synthesize(task)
    wall, cpu = time.perf_counter() - wall, cpu_seconds() - cpu
    synthesis = checked_synthesis(made, task.sample, cell.shape)
    _write(where, synthesis)
    return {
        "status": "ok",
        "message": "",
        "note": synthesis.note,
        "seconds": wall,
        "cpu_seconds": cpu,
        "detection_seconds": synthesis.detection_seconds,
        "lattice_used": synthesis.lattice.as_dict() if synthesis.lattice else None,
    }


def _task(where: CellFolder, cell: Cell) -> Task:
    sample = read_image(where.sample)
    sample.setflags(write=False)
    rng = stream("synthesis", cell.seed, pixels_hash(sample), cell.replicate)
    again = _again_of_method(where, cell) if cell.reference else None
    return Task(sample, cell.shape, cell.lattice_given, rng, again=again)


def _again_of_method(where: CellFolder, cell: Cell) -> Again | None:
    if cell.procedural:
        return lambda shape, k: cell.recipe.again(cell.recipe.render())(shape, k)
    if not where.again.is_file():
        return None
    region = read_image(where.again)

    def draw(shape: Shape, k: int) -> Texture | None:
        fits = k == 0 and region.shape[0] >= shape[0] and region.shape[1] >= shape[1]
        return Texture(region[: shape[0], : shape[1]]) if fits else None

    return draw


def _write(where: CellFolder, synthesis: Synthesis) -> None:
    if synthesis.source is not None:
        write_arrays(where.source, source=synthesis.source)
    for name, array in synthesis.extras.items():
        write_arrays(where.extras / f"{Path(name).name}.npz", array=array)
        if is_picture(array):
            write_image(where.extras / f"{Path(name).name}.png", array)
    write_image(where.output, synthesis.image)


def detect(folder: Path, send: Send) -> None:
    """Find the lattice of a sample by the detector that ``cell.json`` names, and send it."""
    where = CellFolder(folder)
    asked = read_json(where.cell_file) or {}
    detector = plugins.build("detectors", asked["detector"], asked["parameters"])
    try:
        found = timed_detection(detector, read_image(where.sample))
    except (Exception, SystemExit) as error:
        traceback.print_exc()
        send({"status": "error", "message": f"{type(error).__name__}: {error}"})
        return
    send({"status": "ok", "message": found.reason, **found.as_dict()})


def read_cell(where: CellFolder) -> Cell:
    """Return the cell that a folder was made for."""
    content = read_json(where.cell_file)
    assert content is not None, f"{where.cell_file} is written before any child starts"
    return Cell.from_dict(content)
