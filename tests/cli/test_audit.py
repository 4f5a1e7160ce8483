"""Fresh seeds, and the audit that finds methods that know the published samples."""

import re
from pathlib import Path

import pytest
from commands import call

import nrbench
from nrbench.errors import BadInput

KNOWING = '''
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from nrbench import Synthesis, Task
from nrbench.suites.plan import make_plan
from nrbench.suites.suite import load_suite


@dataclass(frozen=True)
class Knowing:
    """Draw the published texture again."""

    name: ClassVar[str] = "knowing"
    uses_lattice: ClassVar[bool] = False

    def synthesize(self, task: Task) -> Synthesis:
        for cell in make_plan(load_suite("SUITE")).cells:
            texture = cell[0].recipe.render()
            if np.abs(texture.image - task.sample).max() < 0.01:
                return Synthesis(cell[0].recipe.again(texture)(task.shape, 99).image)
        return Synthesis(np.resize(task.sample, (*task.shape, 3)))
'''
"""A method that looks the sample up in the published suite, and draws its texture again."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a suite of six textures, and the method that knows its samples."""
    folder = tmp_path_factory.mktemp("audit")
    rows = "".join(
        f'[[texture]]\nname = "wall-{i}"\ndataset = "brick"\nparameters = {{ color = 0.{i + 1} }}\n' for i in range(6)
    )
    suite = f'name = "walls"\nseed = 1\nsample = "64x64"\nsize = "80x80"\nmethods = ["scatter"]\n{rows}'
    (folder / "walls.toml").write_text('metrics = ["quality"]\n' + suite)
    (folder / "knowing.py").write_text(KNOWING.replace("SUITE", str(folder / "walls.toml")))
    return folder


def test_the_audit_finds_a_method_that_knows_the_samples(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A method that draws the published samples again is found, with exit code 1; another audit of it resumes."""
    line = f"--plugin {folder / 'knowing.py'} audit knowing {folder / 'walls.toml'} --jobs 0 --out {folder / 'audit'}"
    assert call(line) == 1
    first = capsys.readouterr().out
    assert "lower by more than other draws move it" in first
    assert call(line) == 1
    assert capsys.readouterr().out == first


def test_a_fresh_seed_is_told_kept_and_marked(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same command keeps its fresh seed, another directory gets another one, and the table names it as fresh."""
    monkeypatch.chdir(folder)
    line = "run walls.toml -t wall-0 --jobs 0 --no-report --seed"
    outputs = []
    for words in ("fresh", "fresh", "fresh --out other"):
        assert call(f"{line} {words}") == 0
        outputs.append(capsys.readouterr())
    seeds = [int(re.findall(r"fresh seed (\d+);", each.err)[0]) for each in outputs]
    assert seeds[0] == seeds[1] != seeds[2]
    assert f"fresh seed {seeds[0]}" in outputs[0].out
    assert nrbench.load("runs/walls-fresh").seed_text == f"fresh seed {seeds[0]}"
    assert call(f"{line} {seeds[2]} --out other") == 0
    assert nrbench.load("other").seed_text == f"seed {seeds[2]}", "a seed that was chosen is not fresh"
    assert call("run walls.toml --seed new") == 2


def test_pictures_cannot_be_audited(folder: Path) -> None:
    """The audit of a suite of pictures is refused, because no seed draws them again."""
    assert call(f"render brick -o {folder / 'pictures'} --size 96x96") == 0
    row = f'name = "wall"\ndataset = "images"\nparameters = {{ path = "{folder / "pictures" / "*.png"}" }}\n'
    (folder / "pictures.toml").write_text(f'name = "pictures"\nmethods = ["scatter"]\n[[texture]]\n{row}')
    with pytest.raises(BadInput, match="no seed draws again"):
        nrbench.audit("scatter", folder / "pictures.toml")


def test_the_site_compares_runs_and_marks_fresh_seeds(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each method of each run is a row with its seed; rows of fresh seeds are marked; a method has one page."""
    runs = " ".join(str(folder / "audit" / name) for name in ("published", "fresh"))
    assert call(f"--plugin {folder / 'knowing.py'} site {runs} -o {folder / 'site'}") == 0
    assert [Path(line).name for line in capsys.readouterr().out.split()] == ["index.html", "knowing.html"]
    index = (folder / "site" / "index.html").read_text()
    rows = re.findall(r'<tr data-find="([^"]*)">', index)
    assert len(rows) == 2
    assert "seed 1 published" in rows[0], "the better row is the first one"
    assert "fresh seed" in rows[1]
    assert index.count("<section>") == 1, "equal textures share a table"
    assert index.count("<td><b>fresh</b> ") == 1
    assert "wall-5" in (folder / "site" / "knowing.html").read_text()
    assert call(f"site {folder} -o {folder / 'site'}") == 2, "the folder is no run"
