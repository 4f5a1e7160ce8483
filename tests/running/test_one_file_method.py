"""A new synthesizer is one file, and few calls lie between the command line and its method."""

import json
import sys
import threading
import time
import traceback
from pathlib import Path

from commands import call

import nrbench

METHOD = '''
import json
import time
import traceback
from dataclasses import dataclass

import numpy as np

from nrbench import Synthesis, user_path


@dataclass(frozen=True)
class Mirrored:
    """The sample and its mirror images."""

    uses_lattice = False

    def synthesize(self, task):
        stack, part = user_path("stack.json"), user_path("part")
        part.write_text(json.dumps([frame.filename for frame in traceback.extract_stack()]))
        part.rename(stack)
        while stack.exists():
            time.sleep(0.01)
        return Synthesis(np.pad(task.sample, ((0, task.shape[0] - 64), (0, task.shape[1] - 64), (0, 0)), "symmetric"))
'''
SUITE = 'sample = "64x64"\nsize = "96x80"\nmetrics = ["cost"]\ntexture = [{ name = "wall", dataset = "brick" }]\n'
MOST_FRAMES = 15


def own(files: list[str]) -> list[str]:
    """Return the files of the frames of a stack that are nrbench's, from the outermost call on."""
    root = str(Path(nrbench.__file__).parent)
    return [file.removeprefix(root) for file in files if file.startswith(root)]


def test_a_method_of_one_file_has_a_row_and_is_called_through_few_frames(tmp_path: Path) -> None:
    """Its cell is in the table; the run, in all its threads, and the forked child together hold few frames."""
    (tmp_path / "mine.py").write_text(METHOD)
    (tmp_path / "s.toml").write_text('name = "s"\n' + SUITE)
    stacks: list[list[str]] = []

    def watch() -> None:
        while not (tmp_path / "stack.json").exists():
            time.sleep(0.05)
        running = [traceback.extract_stack(frame) for frame in sys._current_frames().values()]
        stacks.append(json.loads((tmp_path / "stack.json").read_text()))
        stacks.extend([frame.filename for frame in stack] for stack in running)
        (tmp_path / "stack.json").unlink()

    watcher = threading.Thread(target=watch)
    watcher.start()
    assert call("--plugin mine.py run s.toml -m mirrored --jobs 1 --no-report --out run") == 0
    watcher.join()
    (record,) = nrbench.load("run").cells
    assert (record.method, record.status) == ("mirrored", "ok")
    frames = [own(stack) for stack in stacks]
    assert frames[0][0].endswith("worker.py")  # that of the child begins in the worker that was forked
    # The thread that reads the messages of the worker is not on the way.
    calls = [stack for stack in frames if stack and stack != ["/running/worker.py"]]
    assert len(calls) == 3 and sum(map(len, calls)) <= MOST_FRAMES, calls
