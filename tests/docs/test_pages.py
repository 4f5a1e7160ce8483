"""The pages of the documentation: their examples run, and the site builds."""

import ast
import os
import re
import shlex
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest

from nrbench import plugins
from nrbench.cli.main import main

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
BLOCK = re.compile(r"<!-- (run|file (\S+)) -->\n```(\w+)\n(.*?)```", re.DOTALL)
HOW_TO = sorted(DOCS.glob("*.md"))
"""The pages for users, authors of plugins and maintainers; those of measurements lie in a folder below."""
WITH_EXAMPLES = [page.name for page in HOW_TO if BLOCK.search(page.read_text("utf-8"))]
LARGEST = 12_000
"""Bytes of a page that somebody reads to do something."""


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Run cells in this process by the metrics of the headlines, and forget plugins of files afterwards."""
    headlines = ["regularity", "integrity", "randomness", "quality"]
    monkeypatch.setattr("nrbench.running.runner.find_metrics", lambda names, tell=None: list(names) or headlines)
    monkeypatch.setattr("os.cpu_count", lambda: 0)
    monkeypatch.setattr(plugins.registry, "_files", {})


def run_commands(text: str) -> None:
    """Run each line of a block as a command, with smaller outputs; none may fail."""
    for line in text.strip().splitlines():
        program, *words = shlex.split(line, comments=True)
        assert program == "nrbench"
        words += ["--size", "144x144"] if "run" in words and "--size" not in words else []
        with pytest.raises(SystemExit) as ended:
            main(words)
        assert not ended.value.code, line


def test_some_pages_have_examples() -> None:
    """The tutorial and the page on suites are executed."""
    assert {"tutorial.md", "suites.md"} <= set(WITH_EXAMPLES)


@pytest.mark.parametrize("name", WITH_EXAMPLES)
def test_the_examples_of_a_page_run(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """The blocks of a page that are marked run one after another in an empty directory."""
    names: dict[str, object] = {}
    for kind, file, language, text in BLOCK.findall((DOCS / name).read_text("utf-8")):
        if file:
            Path(file).write_text(text, "utf-8")
        elif language == "python":
            exec(compile(text, f"{name} ({kind})", "exec"), names)
        else:
            assert language == "bash"
            run_commands(text)
    assert capsys.readouterr().out


@pytest.mark.parametrize("page", HOW_TO, ids=lambda page: page.name)
def test_pages_are_short(page: Path) -> None:
    """A page that tells how to do something has at most 12 kB."""
    assert page.stat().st_size <= LARGEST


@pytest.mark.parametrize(
    "page", [*HOW_TO, *sorted(DOCS.glob("measurements/*.md")), *sorted(ROOT.glob("*.md"))], ids=lambda page: page.name
)
def test_links_lead_somewhere(page: Path) -> None:
    """Every link of a page to a file leads to one."""
    for target in re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", page.read_text("utf-8")):
        assert (page.parent / target).exists(), target


def test_all_presets_are_shown() -> None:
    """The page of pictures has one of each method with presets, and none is larger than 400 kB."""
    page = (DOCS / "presets.md").read_text("utf-8")
    classes = {name: plugins.find("synthesizers", name).cls for name in plugins.names("synthesizers")}
    for name in (name for name, cls in classes.items() if getattr(cls, "presets", {})):
        assert f"(presets/{name}.jpg)" in page, name
    assert all(file.stat().st_size <= 400_000 for file in DOCS.glob("presets/*.jpg"))


@pytest.mark.parametrize("page", ["structure.md", "maintainer.md"])
def test_files_that_a_page_names_are_there(page: str) -> None:
    """Each file and folder of the tree that a page names exists, and has the functions and classes that it names."""
    folders = "|".join(path.name for path in ROOT.iterdir() if path.is_dir() and path.name.isidentifier())
    named = 0
    for line in (DOCS / page).read_text("utf-8").splitlines():
        files = [ROOT / name for name in re.findall(rf"`((?:{folders})/[\w./]*)`", line)]
        assert all(file.exists() for file in files), line
        text = "".join(file.read_text("utf-8") for file in files if file.is_file())
        for name in re.findall(r"(?:function|class|property) `(?:\w+\.)?(\w+)`", line) if files else ():
            assert re.search(rf"\b{name}\b", text), line
        named += len(files)
    assert named >= 10


def test_the_page_of_the_structure_has_all_floors() -> None:
    """The table and the picture of docs/structure.md have the floors that the tests of the structure check."""
    tree = ast.parse((ROOT / "tests" / "core" / "test_structure.py").read_text("utf-8"))
    (floors,) = (
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "FLOORS"
    )
    names = [[name.removeprefix("nrbench.") for name in floor] for floor in floors]
    page, picture = ((DOCS / file).read_text("utf-8") for file in ("structure.md", "structure.svg"))
    rows = re.findall(r"^\| \d+ \| (.*?) \|", page, re.MULTILINE)
    assert [re.findall(r"`(\w+)`", row) for row in rows] == names
    drawn = re.findall(r'class="name">(\w+)<', picture)
    assert drawn == [name for floor in names for name in floor if name != "__main__"]


def test_scripts_are_valid() -> None:
    """The script that leads to a paper's table can be read by a shell."""
    subprocess.run(["sh", "-n", str(ROOT / "benchmarks" / "paper_table.sh")], check=True)


def test_the_paper_table_passes_methods_on_whole(tmp_path: Path) -> None:
    """The script runs the methods of a suite beside one's own, also a program whose command holds spaces."""
    suite, log, fake = tmp_path / "suite.toml", tmp_path / "log", tmp_path / "nrbench"
    suite.write_text('methods = ["rsgf", "command:run=tool {sample} {output},label=my tool"]\n')
    (tmp_path / "run" / "tables").mkdir(parents=True)
    for name in ("summary.tex", "methods.bib"):
        (tmp_path / "run" / "tables" / name).touch()
    fake.write_text(f'#!/bin/sh\nfor one in "$@"; do echo "$one" >> "{log}"; done\n')
    fake.chmod(0o755)
    script = [str(ROOT / "benchmarks" / "paper_table.sh"), str(tmp_path / "run"), "mine.py", "mine", str(suite)]
    subprocess.run(["sh", *script], check=True, env={**os.environ, "NRBENCH": str(fake)}, capture_output=True)
    given = log.read_text().splitlines()
    methods = [value for flag, value in pairwise(given) if flag == "-m"]
    assert methods == ["rsgf", "command:run=tool {sample} {output},label=my tool", "mine"]
    assert sorted(path.name for path in (tmp_path / "run" / "paper").iterdir()) == ["methods.bib", "summary.tex"]


def test_the_site_builds(tmp_path: Path) -> None:
    """The site builds, and a warning is an error."""
    for needed in ("sphinx", "pydata_sphinx_theme", "myst_parser", "numpydoc", "sphinx_copybutton"):
        pytest.importorskip(needed, reason=f"{needed} is not installed: pip install nrbench[docs]")
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-W",
        "--keep-going",
        "-q",
        "-b",
        "html",
        str(DOCS),
        str(tmp_path / "out"),
    ]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert "nrbench.synthesize" in (tmp_path / "out" / "commands.html").read_text("utf-8")
