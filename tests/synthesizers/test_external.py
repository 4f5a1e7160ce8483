"""Claims about outputs of other programs: a command that is run, and pictures in a folder."""

import os
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import FIELDS, TILES, script
from synthesis_cases import noise

from nrbench.errors import BadInput
from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice
from nrbench.pictures.files import write_image
from nrbench.plugins.forms import Refused, Synthesis, Task
from nrbench.suites.plan import PlannedMethod, make_plan
from nrbench.suites.suite import validated_suite
from nrbench.synthesizers.command import Command
from nrbench.synthesizers.precomputed import Precomputed, name_for

SAMPLE = noise(20, 24)


def run(command: str, seed: int = 0) -> Synthesis:
    """Run a command on a sample."""
    return Command(run=command).synthesize(Task(SAMPLE, (30, 50), None, np.random.default_rng(seed)))


def test_a_program_gets_the_sample_and_its_picture_comes_back(tmp_path: Path) -> None:
    """Width, height, seed and both paths reach the program, in words with blanks, too; its output is returned."""
    made = run(f"{script(tmp_path, TILES)} {FIELDS}")
    expected = np.tile(SAMPLE, (9, 9, 1))[:30, :50]
    np.testing.assert_array_equal(made.image[1:], expected[1:])
    assert made.image.shape == (30, 50, 3)


def test_the_seed_comes_from_the_tasks_stream(tmp_path: Path) -> None:
    """The same stream gives the same seed, another gives another."""
    command = f"{script(tmp_path, TILES)} {FIELDS}"
    seeds = [run(command, seed).image[0, 0, 0] for seed in (1, 1, 2)]
    assert seeds[0] == seeds[1] != seeds[2]


def test_the_program_runs_in_a_folder_of_its_own(tmp_path: Path) -> None:
    """What a program litters lands in no one's way, and is gone."""
    litter = f"import os\nopen('litter', 'w').write(os.getcwd())\nopen(r'{tmp_path / 'where'}', 'w').write(os.getcwd())"
    run(f"{script(tmp_path, litter + TILES)} {FIELDS}")
    folder = Path((tmp_path / "where").read_text())
    assert folder != Path.cwd()
    assert not folder.exists()


def test_files_of_the_current_folder_may_be_named() -> None:
    """A script is found by its relative path."""
    Path("tool.py").write_text(TILES)
    assert run(f"'{sys.executable}' tool.py {FIELDS}").image.shape == (30, 50, 3)


@pytest.mark.skipif(os.name == "nt", reason="needs a POSIX shell")
def test_no_shell_reads_the_command(tmp_path: Path) -> None:
    """Semicolons and redirections are mere words to the program."""
    echo = f"import sys; open(r'{tmp_path / 'words'}', 'w').write(repr(sys.argv[6:])); sys.argv[6:] = []"
    run(f"{script(tmp_path, echo + TILES)} {FIELDS} ; echo $HOME > x")
    assert (tmp_path / "words").read_text() == "[';', 'echo', '$HOME', '>', 'x']"


def test_a_program_that_fails_is_quoted(tmp_path: Path) -> None:
    """A non-zero exit code is an error with the tail of what the program said."""
    failing = script(tmp_path, "import sys; sys.stderr.write('x' * 9999 + 'no such texture'); sys.exit(3)")
    with pytest.raises(RuntimeError, match=r"exit code 3: x+no such texture$") as raised:
        run(f"{failing} {{sample}} {{output}}")
    assert len(str(raised.value)) < 2200


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"wrote no \{output\}"),
        ("import sys; open(sys.argv[2], 'w').write('hello')", r"unusable \{output\}: .*no picture"),
    ],
)
def test_a_program_that_writes_no_picture_is_an_error(tmp_path: Path, text: str, message: str) -> None:
    """Ending well is not enough: without an output, or with one that is no picture, the error gives the reason."""
    with pytest.raises(RuntimeError, match=message):
        run(f"{script(tmp_path, text)} {{sample}} {{output}}")


def test_a_program_that_is_missing_is_bad_input() -> None:
    """A program that does not exist is the user's to mend."""
    with pytest.raises(BadInput, match=r"cannot run 'no-such-tool'.*install it or give its path"):
        run("no-such-tool {sample} {output}")


@pytest.mark.parametrize(
    ("command", "hint"),
    [
        ("tool {sample} {outptu}", "{outptu}; known are {sample}, {output}"),
        ("tool {sample}", "lacks {output}"),
        ("tool {sample} {output", "write {{ and }}"),
        ("tool '{sample} {output}", "quotation"),
    ],
)
def test_templates_that_cannot_work_are_refused_at_once(command: str, hint: str) -> None:
    """Unknown and missing fields are named before anything runs."""
    with pytest.raises(BadInput) as raised:
        Command(run=command)
    assert hint in str(raised.value)


SPY = "import sys; open(r'{place}', 'w').write(' '.join(sys.argv[6:])); sys.argv[6:] = []"
GIVEN = Lattice((10.5, 0.0), (-2.25, 1e-5 + 8), (1.0, 2.0))


def test_the_lattice_reaches_the_program(tmp_path: Path) -> None:
    """`{lattice}` is four numbers without exponents, `{t1x}` and the others are its parts, and the result names it."""
    spy = SPY.format(place=tmp_path / "words") + TILES
    method = Command(run=f"{script(tmp_path, spy)} {FIELDS} {{lattice}} {{t2x}} {{originy}}")
    assert method.uses_lattice
    made = method.synthesize(Task(SAMPLE, (30, 50), GIVEN, np.random.default_rng(0)))
    assert (tmp_path / "words").read_text() == "10.5,0,-2.25,8.00001 -2.25 2"
    assert made.lattice == GIVEN


def test_without_a_lattice_a_command_that_takes_one_is_refused(tmp_path: Path) -> None:
    """Noise has no lattice: the program does not start. A command without such a field uses no lattice."""
    with pytest.raises(Refused, match="the command takes one"):
        run(f"{script(tmp_path, TILES)} {FIELDS} {{lattice}}")
    assert not Command(run="tool {sample} {output}").uses_lattice


def test_a_label_names_the_method_in_tables() -> None:
    """`label=` replaces the command line in tables; the lattice axis applies if the command takes the lattice."""
    method = PlannedMethod.parse("command:run=tool {sample} {output} --t1 {t1x} {t1y},label=my tool")
    assert (method.label, method.uses_lattice) == ("my tool", True)
    assert PlannedMethod.parse("command:run=tool {sample} {output}").label == "command:run=tool {sample} {output}"
    assert PlannedMethod.parse("rsgf:preset=paper,label=RSGF 2011").label == "RSGF 2011"
    for label in ("two\nlines", " ", "x" * 61):
        with pytest.raises(BadInput, match="printable"):
            PlannedMethod.parse(f"rsgf:label={label}")


def test_two_methods_of_one_label_are_refused() -> None:
    """Two columns of one name could not be told apart; the error names both methods."""
    one, other = (f"command:run={tool} {{sample}} {{output}},label=mine" for tool in ("a", "b"))
    of_other, of_row = ("rsgf:label=tile-set", "tile-set"), ("quilting:label=rsgf (own)", "rsgf")
    for first, second, name in ((one, other, "mine"), (*of_other, "tile-set"), (*of_row, "rsgf (own)")):
        content = {"name": "x", "methods": [first, second], "texture": [{"name": "wall", "dataset": "brick"}]}
        with pytest.raises(BadInput, match=re.escape(f"label {name!r} in the tables: {first} and {second};")):
            make_plan(validated_suite(content, "x"))


OUTPUT = noise(30, 50, seed=1)


def look_up(folder: Path, sample: Image = SAMPLE, shape: tuple[int, int] = (30, 50)) -> Synthesis:
    """Ask the method for the output of a sample."""
    return Precomputed(str(folder)).synthesize(Task(sample, shape, None, np.random.default_rng(0)))


def test_a_file_named_by_the_samples_pixels_and_the_size_is_found(tmp_path: Path) -> None:
    """HASH-WIDTHxHEIGHT.png is the output for that sample at that size."""
    name = name_for(SAMPLE, (30, 50))
    assert name.endswith("-50x30.png")
    write_image(tmp_path / name, OUTPUT)
    np.testing.assert_array_equal(look_up(tmp_path).image, OUTPUT)


def test_a_table_pairs_files_under_any_names(tmp_path: Path) -> None:
    """index.csv pairs samples, compared by their pixels, with outputs; the row of the right size is taken."""
    for name, image in (
        ("a.png", noise(20, 24, seed=5)),
        ("b.png", SAMPLE),
        ("small.png", noise(9, 9, seed=2)),
        ("c.png", OUTPUT),
    ):
        write_image(tmp_path / name, image)
    (tmp_path / "index.csv").write_text("sample,output\na.png,c.png\nb.png,small.png\nb.png,c.png\n")
    np.testing.assert_array_equal(look_up(tmp_path).image, OUTPUT)
    assert look_up(tmp_path, shape=(9, 9)).image.shape == (9, 9, 3)


def test_where_there_is_none_the_refusal_tells_the_name_looked_for(tmp_path: Path) -> None:
    """An author learns how to name the file."""
    with pytest.raises(Refused, match=f"{name_for(SAMPLE, (30, 50))}.*index.csv"):
        look_up(tmp_path)
