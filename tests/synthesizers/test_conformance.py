"""Every method fulfils every clause of its form."""

from pathlib import Path

import pytest
from commands import FIELDS, TILES, script
from conformance import violations

from nrbench import plugins
from nrbench.authoring.plugin_checks import Subject, make_task
from nrbench.pictures.files import write_image
from nrbench.synthesizers.precomputed import name_for

OPTIONAL = ("own lattice", "source map", "progress")
SLOW = {"fftm-patch": ("randomness",)}
QUICK = {"gpdm": {"steps": 5}, "gpnn": {"iterations": 1}}
"""Parameters of methods that are slow with their defaults."""
INSTALLED = [plugin.name for plugin in plugins.inventory("synthesizers") if plugin.built_in]


@pytest.mark.parametrize("name", [name for name in INSTALLED if name not in ("command", "precomputed")])
def test_a_method_conforms(name: str) -> None:
    """The method fails no clause; it gives no source map and no progress at most."""
    assert violations("synthesizers", name, QUICK.get(name, {}), SLOW.get(name, ()), OPTIONAL) == []


def test_a_program_conforms(tmp_path: Path) -> None:
    """A program that repeats the sample fulfils every clause by way of `command`."""
    parameters, left_out = {"run": f"{script(tmp_path, TILES)} {FIELDS}"}, ("determinism", "randomness", "refusals")
    assert violations("synthesizers", "command", parameters, left_out, OPTIONAL) == []


def test_pictures_conform(tmp_path: Path) -> None:
    """Outputs in a folder fulfil every clause by way of `precomputed`."""
    subject = Subject("synthesizers", "precomputed", {"directory": str(tmp_path)})
    for seed, channels in ((0, 3), (5, 3), (0, 1)):
        task = make_task(subject, seed, channels)
        write_image(tmp_path / name_for(task.sample, task.shape), task.sample[:1, :1].repeat(96, 0).repeat(112, 1))
    assert violations("synthesizers", "precomputed", {"directory": str(tmp_path)}, (), OPTIONAL) == []
