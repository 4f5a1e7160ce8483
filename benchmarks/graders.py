"""Whether graders who do not know the methods prefer the outputs of `resample`, and call them odd.

``python benchmarks/graders.py [--sets NAME ...]``

Prints the shares of the answers in ``labels/graders.csv``: how often `resample` was preferred to another method, or
judged equal, and how often the outputs of each method were called odd, over all graders and by grader. Each share is
the mean over regions, with a 95 % interval by bootstrap over them.

``python benchmarks/graders.py ask SUITE FOLDER [--photographs FOLDER] [--name NAME]``

Makes what graders look at. SUITE is ``photographs-3``, ``photographs-4``, ``photographs-choosing`` or ``prints-2``; the
suites stand in ``labels/``. FOLDER/run is the run with the outputs. The lattice of photographs is found by
``consensus``, that of prints is given. FOLDER/pages has the pages, on which the sample stands beside two outputs, A and
B, one of them by `resample`; of prints beside one output, by `resample` or a fresh draw. It also has the questions,
``graders-pairs.md`` or ``graders-prints.md``. FOLDER/key.csv tells what was shown; graders must not see it.

``python benchmarks/graders.py add FOLDER ANSWERS.csv ... [--by KIND]``

Adds the answers of graders to ``labels/graders.csv``, one file for each grader, which its name tells.
"""

import argparse
import contextlib
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from prints import draw_graded
from scipy.stats import bootstrap

import nrbench
from nrbench.errors import BadInput, require
from nrbench.imaging.convert import Image
from nrbench.pictures.files import read_image, write_image
from nrbench.pictures.overlays import contact_sheet
from nrbench.runs.records import CellRecord, Run
from nrbench.streams import pixels_hash, stream

LABELS = Path(__file__).resolve().parent / "labels"
ANSWERS = LABELS / "graders.csv"
OURS, FRESH = "resample", "oracle"
KEY = ["number", "set", "suite", "prompt", "texture", "a", "a_pixels", "b", "b_pixels"]
"""The columns of a key: the methods A and B, and the hashes of their pixels. B is empty where one output was shown."""
GIVEN = {"graders-pairs.md": ["better", "odd_a", "odd_b", "why"], "graders-prints.md": ["odd", "why"]}
"""The columns of the answers to each list of questions, after the number."""
ALLOWED = {"better": ("A", "B", "equal"), "odd": ("0", "1"), "odd_a": ("0", "1"), "odd_b": ("0", "1")}
STORED = [*KEY, "labeled_by", "grader", "better", "odd_a", "odd_b", "why"]
"""The columns of the stored answers, one row for each grader and showing."""
SIDE = 512
"""px: smaller outputs are enlarged up to this side."""
ON_PAGE = {1: 2, 2: 1}
"""Rows on a page with one and with two outputs in a row: larger pages would be scaled down where they are shown."""
RESAMPLES = 9999


# Pages


@contextlib.contextmanager
def folder_of(suite: str, photographs: Path, target: Path) -> Iterator[None]:
    """Work in the folder of the pictures of a suite; prints are drawn into the target."""
    prints = target / "prints"
    if suite == "prints-2":
        draw_graded(prints)
    with contextlib.chdir(prints if suite == "prints-2" else photographs):
        yield


def pair_outputs(run: Run, seed: int) -> list[tuple[CellRecord, ...]]:
    """Return what is shown, in random order: pairs with an output of `resample`; of prints, single outputs.

    A pair is left out, and told, where one of the outputs is missing.
    """
    rng, shown = stream("graders", seed), list[tuple[CellRecord, ...]]()
    for texture in sorted({cell.texture for cell in run.cells}):
        cells = {cell.method: cell for cell in run.cells if cell.texture == texture}
        for cell in cells.values():
            if cell.status != "ok":
                print(f"{texture}, {cell.method}: {cell.status} {cell.result.get('message', '')}")
        done = {name: cell for name, cell in cells.items() if cell.status == "ok"}
        ours = done.pop(OURS, None)
        if FRESH in cells:
            shown += [(cell,) for cell in (ours, *done.values()) if cell]
        elif ours:
            shown += [tuple((ours, other)[k] for k in rng.permutation(2)) for other in done.values()]
    return [shown[k] for k in rng.permutation(len(shown))]


def enlarge(image: Image, factor: int) -> Image:
    """Return an image with each pixel repeated."""
    return image.repeat(factor, 0).repeat(factor, 1)


def write_pages(shown: Sequence[tuple[CellRecord, ...]], folder: Path) -> list[Path]:
    """Write the pages in place of earlier ones, and return their files."""
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("page_*.png"):
        old.unlink()
    pages, rows = [], ON_PAGE[len(shown[0])]
    for first in range(0, len(shown), rows):
        pictures, captions = [], []
        for number, cells in enumerate(shown[first : first + rows], first + 1):
            outputs = [read_image(cell.folder / "output.png") for cell in cells]
            factor = max(1, SIDE // max(outputs[0].shape))
            pictures += [enlarge(each, factor) for each in (read_image(cells[0].folder / "sample.png"), *outputs)]
            captions += [f"{number}: sample", *([f"{number}: A", f"{number}: B"] if len(cells) > 1 else [f"{number}"])]
        page = contact_sheet(pictures, captions, len(shown[0]) + 1, 16)
        pages.append(write_image(folder / f"page_{len(pages) + 1:02d}.png", page))
    return pages


def make_key(shown: Sequence[tuple[CellRecord, ...]], name: str, suite: str) -> pd.DataFrame:
    """Return the key of what is shown, with the columns :data:`KEY`."""
    rows = []
    for number, cells in enumerate(shown, 1):
        sides = [(cell.method, pixels_hash(read_image(cell.folder / "output.png"))[:16]) for cell in cells]
        prompt = "graders-pairs.md" if len(cells) > 1 else "graders-prints.md"
        rows.append([str(number), name, suite, prompt, cells[0].texture, *sides[0], *(sides[1:] or [("", "")])[0]])
    return pd.DataFrame(rows, columns=KEY)


def ask(suite: str, target: Path, photographs: Path, name: str, seed: int) -> None:
    """Make the outputs, the pages and the key. Outputs of `resample` are always made anew, those of others are kept."""
    target = target.resolve()
    if (target / "run").exists():
        for cell in nrbench.load(target / "run").cells:
            if cell.method == OURS:
                shutil.rmtree(cell.folder)
    with folder_of(suite, photographs, target):
        run = nrbench.run(LABELS / f"{suite}.toml", out=target / "run", options=nrbench.Options(jobs=1))
    shown = pair_outputs(run, seed)
    pages, key = write_pages(shown, target / "pages"), make_key(shown, name, suite)
    key.to_csv(target / "key.csv", index=False)
    shutil.copy(LABELS / key["prompt"][0], target / "pages" / "QUESTIONS.md")
    print(f"{len(shown)} rows on {len(pages)} pages in {target / 'pages'}")


# Answers


def read_answers(key: pd.DataFrame, file: Path, labeled_by: str) -> pd.DataFrame:
    """Read the answers of one grader, whose name is the stem of the file.

    Parameters
    ----------
    key
        What was shown.
    file
        CSV with the columns that the questions name.
    labeled_by
        What the grader is, such as ``vision-language model``.

    Returns
    -------
    pandas.DataFrame
        One row a showing, with the columns :data:`STORED`.

    Raises
    ------
    BadInput
        For wrong columns, an answer that is not allowed, or a number that is missing, unknown or answered twice.
    """
    columns = GIVEN[key["prompt"].iloc[0]]
    given = pd.read_csv(file, dtype=str, keep_default_na=False).rename(columns=str.strip)
    require(
        list(given.columns) == ["number", *columns],
        f"{file}: expected columns number,{','.join(columns)}, got {','.join(given.columns)}",
    )
    given = given.apply(lambda column: column.str.strip())
    for column in set(columns) & set(ALLOWED):
        wrong = given[~given[column].isin(ALLOWED[column])]
        if len(wrong):
            number, answer = wrong.iloc[0][["number", column]]
            raise BadInput(f"{file}: {column} of number {number} is {answer!r}; use {', '.join(ALLOWED[column])}")
    numbers = given["number"].tolist()
    amiss = sorted(set(numbers) ^ set(key["number"])) + [each for each in set(numbers) if numbers.count(each) > 1]
    require(not amiss, f"{file}: number {amiss[:1]} is missing, unknown or answered twice; answer each number once")
    given = given.rename(columns={"odd": "odd_a"})
    answers = key.merge(given, on="number").assign(labeled_by=labeled_by, grader=file.stem)
    return answers.reindex(columns=STORED, fill_value="")


def add(target: Path, files: Sequence[Path], labeled_by: str) -> None:
    """Add answers to the stored ones; those of the same set and grader are replaced."""
    key = pd.read_csv(target / "key.csv", dtype=str, keep_default_na=False)
    added = pd.concat([read_answers(key, file, labeled_by) for file in files])
    if ANSWERS.exists():
        kept = pd.read_csv(ANSWERS, dtype=str, keep_default_na=False)
        rows, given = (pd.MultiIndex.from_frame(part[["set", "grader"]]) for part in (kept, added))
        added = pd.concat([kept[~rows.isin(given)], added])
    added.to_csv(ANSWERS, index=False)


def preferences(answers: pd.DataFrame) -> pd.DataFrame:
    """Return one row a pair: ``texture``, ``grader``, ``other`` method, ``value`` 1 preferred, 0.5 equal, 0 not.

    ``same`` tells whether both outputs had the same pixels, as where `resample` falls back to `tile-set`.
    """
    pairs = answers[answers["better"] != ""]
    is_a = pairs["a"] == OURS
    ours = np.where(is_a, "A", "B")
    value = np.where(pairs["better"] == "equal", 0.5, (pairs["better"] == ours) * 1.0)
    other, same = pairs["b"].where(is_a, pairs["a"]), pairs["a_pixels"] == pairs["b_pixels"]
    return pairs[["texture", "grader"]].assign(other=other, value=value, same=same)


def oddities(answers: pd.DataFrame) -> pd.DataFrame:
    """Return one row an output that was shown: ``texture``, ``grader``, ``method``, ``value`` 1 if called odd."""
    parts = [
        answers[["texture", "grader"]].assign(method=answers[side], value=answers[f"odd_{side}"]) for side in ("a", "b")
    ]
    rows = pd.concat(parts)
    return rows[rows["value"] != ""].astype({"value": float})


def share_text(rows: pd.DataFrame, values: pd.Series) -> str:
    """Return the mean over textures of truth values, with a 95 % interval by bootstrap over textures."""
    means = values.astype(float).groupby(rows["texture"]).mean().to_numpy()
    if len(means) < 2:
        return f"{means.mean():.2f}"
    options = {"n_resamples": RESAMPLES, "method": "percentile", "rng": np.random.default_rng(0)}
    ends = bootstrap((means,), np.mean, **options).confidence_interval
    return f"{means.mean():.2f} [{ends.low:.2f}, {ends.high:.2f}]"


def print_set(answers: pd.DataFrame) -> None:
    """Print the shares of one set."""
    graders = sorted(answers["grader"].unique())
    views = [("all", answers), *((name, answers[answers["grader"] == name]) for name in graders)]
    kinds = ", ".join(sorted(answers["labeled_by"].unique()))
    print(f"\n{answers['set'].iloc[0]}: {len(graders)} graders ({kinds}), {answers['texture'].nunique()} regions")
    for who, part in views:
        rows = preferences(part)
        for other in ("", *sorted(rows["other"].unique())) if len(rows) else ():
            some = rows if not other else rows[rows["other"] == other]
            either, better = share_text(some, some["value"] > 0), share_text(some, some["value"] == 1)
            same = f"{len(some)} pairs, {some['same'].sum()} of the same pixels"
            print(f"  {who}: {OURS} and {other or 'others'}: preferred or equal {either}, preferred {better}; {same}")
        rows = oddities(part)
        for method in sorted(rows["method"].unique()):
            some = rows[rows["method"] == method]
            print(f"  {who}: {method} odd {share_text(some, some['value'])}; shown {len(some)} times")


def main() -> None:
    """Make pages, add answers, or print the stored ones."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    studies = parser.add_subparsers(dest="study")
    asks, adds = studies.add_parser("ask"), studies.add_parser("add")
    asks.add_argument("suite")
    asks.add_argument("folder", type=Path)
    asks.add_argument("--photographs", type=Path, default=Path())
    asks.add_argument("--name", help="name of the set; by default that of the suite")
    asks.add_argument("--seed", type=int, default=46)
    adds.add_argument("folder", type=Path)
    adds.add_argument("files", nargs="+", type=Path)
    adds.add_argument("--by", default="vision-language model")
    parser.add_argument("--sets", nargs="+", default=())
    options = parser.parse_args()
    if options.study == "ask":
        ask(options.suite, options.folder, options.photographs, options.name or options.suite, options.seed)
    elif options.study == "add":
        add(options.folder, options.files, options.by)
    else:
        stored = pd.read_csv(ANSWERS, dtype=str, keep_default_na=False)
        for name in options.sets or stored["set"].unique():
            print_set(stored[stored["set"] == name])


if __name__ == "__main__":
    main()
