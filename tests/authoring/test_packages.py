"""``nrbench new``: the package of every kind installs, passes ``nrbench check``, and is used by the commands."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from commands import call
from hypothesis import example, given
from hypothesis import strategies as st

from nrbench import plugins
from nrbench.authoring.conformance import check_plugin
from nrbench.authoring.packages import KINDS, check_name, new_plugin
from nrbench.errors import BadInput


@pytest.mark.parametrize("kind", KINDS)
def test_a_new_plugin_conforms(kind: str, tmp_path: Path) -> None:
    """The plugin of a new package, loaded from its file, has the package's name and fails no clause."""
    assert call("new", kind, "my-own_1") == 0
    file = tmp_path / "my-own_1" / "my_own_1.py"
    try:
        plugins.add_file(file)
        findings = list(check_plugin(KINDS[kind], "my-own_1", here=True))
    finally:
        plugins.registry._files.pop(file.resolve(), None)
    assert [finding for finding in findings if finding.verdict == "fail"] == []
    skipped = {finding.clause for finding in findings if finding.verdict == "skip"}
    assert skipped <= {"paper", "processes", "progress", "terminal"}


def test_a_package_installs_and_runs(tmp_path: Path) -> None:
    """Installed by pip without network, the method is listed, passes its own tests, and makes a picture."""
    (folder,) = {path.parent for path in new_plugin("synthesizer", "my-tiles")}
    site = tmp_path / "site"
    options = ["--no-deps", "--no-build-isolation", "--no-index", "--quiet", "--target", str(site)]
    subprocess.run(
        [sys.executable, "-m", "pip", "install", *options, str(folder.resolve())], check=True, capture_output=True
    )
    path = os.pathsep.join([str(site), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = {**os.environ, "PYTHONPATH": path}
    program = "from nrbench.cli.main import main; main()"
    listed = subprocess.run(
        [sys.executable, "-c", program, "show", "my-tiles"], env=environment, capture_output=True, text=True
    )
    assert "my-tiles" in listed.stdout and "Copies of random cells" in listed.stdout, listed.stderr
    tested = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(folder)],
        env=environment,
        capture_output=True,
        text=True,
    )
    assert tested.returncode == 0 and "2 passed" in tested.stdout, tested.stdout


HOSTILE = (
    *("../up", "a/b", "a b", "", "-x", "Ümlaut", "x\ny", "import", "match", "os", "numpy", "con", "a--b", "A"),
    "x" * 41,
)


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_name_is_one_error(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A name that is a path, a keyword or a module is refused on one line with exit code 2; nothing is written."""
    assert call("new", "metric", "--", name) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_a_name_that_is_taken_is_refused() -> None:
    """The name of a method cannot be given to another method, but to a metric."""
    with pytest.raises(BadInput, match="a method of this name exists"):
        check_name("synthesizer", "rsgf")
    assert check_name("metric", "rsgf")["class_"] == "Rsgf"


def test_an_existing_folder_is_left_alone(tmp_path: Path) -> None:
    """A folder that exists is refused, and nothing in it changes; nor is a folder made in one that does not exist."""
    (tmp_path / "mine").mkdir()
    assert call("new", "report", "mine") == 2
    assert call("new", "report", "mine", "-o", "no/where") == 2
    assert [path.name for path in tmp_path.rglob("*")] == ["mine"]


@given(st.text(max_size=50))
@example("a-b_c1")
def test_a_valid_name_is_a_module(name: str) -> None:
    """Any text is refused, or gives a module and a class that are identifiers and no path."""
    try:
        words = check_name("dataset", name)
    except BadInput:
        return
    assert words["module"].isidentifier() and words["class_"].isidentifier() and name.isascii()
