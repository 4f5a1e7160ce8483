"""Each verb of the command line has a function that says the same."""

import inspect
import os
from typing import Any

import pytest
from commands import call

import nrbench
from nrbench.cli.main import VERBS
from nrbench.cli.main import nrbench as program

FUNCTIONS = {verb: getattr(nrbench, verb, None) for verb in VERBS} | {
    "list": nrbench.list_plugins,
    "show": nrbench.show_plugin,
    "synth": nrbench.synthesize,
    "render": nrbench.render_textures,
    "new": nrbench.new_plugin,
}
"""The function of each verb. Those of `check` and `lattice` take what the commands find in files and folders."""
IN_PYTHON = {"progress", "options", "parameters", "changes", "tell_failure"}
"""Parameters for programs, which the command line fills itself or writes within the name of a plugin."""
NOT_TO_FILL = {"method", "shape"}
"""What `synth` requires, but not with --fill, which is a function of its own, ``nrbench.fill``."""
CHOICE = "core -m scatter -t brick-mild --size 64x64"


@pytest.mark.parametrize("verb", sorted({*VERBS} - {"check", "lattice"}))
def test_a_command_and_its_function_have_the_same_options(verb: str) -> None:
    """Each parameter of the function is an option of the command with the same default, and each has a help."""
    command: Any = program.get_command(None, verb)
    given = {option.name: option for option in command.params}
    signature = inspect.signature(FUNCTIONS[verb]).parameters
    parameters = {name: each.default for name, each in signature.items() if name not in IN_PYTHON}
    assert command.function is FUNCTIONS[verb] and parameters.keys() <= given.keys()
    for name, default in parameters.items():
        required = default is inspect.Parameter.empty
        assert given[name].required == (required and (verb != "synth" or name not in NOT_TO_FILL)), name
        assert required or (given[name].to_info_dict()["default"] or None) == (default or None), name
    how = {name: each.default for name, each in inspect.signature(nrbench.Options).parameters.items()}
    for name in given.keys() & how.keys() - {"jobs"}:
        assert (given[name].to_info_dict()["default"] or None) == (how[name] or None), name
    assert nrbench.Options().jobs == (os.cpu_count() or 1)
    assert all(option.help for option in command.params if option.param_type_name == "option")


def test_few_frames_lead_from_main_to_execute(monkeypatch: pytest.MonkeyPatch) -> None:
    """Between the entry point and the runner stand at most two functions of nrbench."""
    seen: list[str] = []

    def stop(*_: object, **__: object) -> None:
        frames = [frame.function for frame in inspect.stack() if "/nrbench/" in frame.filename]
        seen.extend(frames[: frames.index("main") + 1])
        raise KeyboardInterrupt

    monkeypatch.setattr("nrbench.running.runner.execute", stop)
    assert call(f"run {CHOICE} --out r") == 130
    assert seen[-1] == "main" and len(seen) <= 3
