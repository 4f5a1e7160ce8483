"""Write how far the ranking depends on choices: other summaries, each texture left out, other seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pandas as pd
from scipy.stats import kendalltau, rankdata, trim_mean

from nrbench.errors import BadInput
from nrbench.runs.records import Run
from nrbench.storage import write_files

from .csv import csv_text
from .markdown import escape_markdown, pipe_table
from .statistics.estimates import Floats, adjust_means
from .statistics.format import format_number
from .statistics.method_comparison import compare_methods
from .statistics.summaries import Method
from .statistics.verdicts import PERILS, QUALITY, RANKING, keep_listed_textures, tabulate_cells

_TRIM = 0.1


@dataclass(frozen=True)
class RankingRobustness:
    """``robustness.md`` and ``robustness.csv``: the ranking under other choices, and which places are settled.

    Each row is one way to rank: the mean quality, as the tables do; the geometric mean and the mean of the four perils
    of each output in place of the worst; the median, and the mean without the best and worst tenth of the textures;
    failures and refusals left out; each texture left out; and each other run that is given, such as one of another
    seed. Each has Kendall's tau with the ranking of the tables, and the place of each method. A place is settled if the
    method has it in all rows.

    Parameters
    ----------
    runs
        The directories of other runs of the same methods, such as those of other seeds.
    """

    runs: tuple[Path, ...] = ()

    version: ClassVar[str] = "1"
    folder: ClassVar[str] = "tables"

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Write the files and return their paths."""
        table = self.table(run)
        return write_files(directory, {"robustness.csv": csv_text(table), "robustness.md": _markdown(table)})

    def table(self, run: Run) -> pd.DataFrame:
        """Return one row a ranking: what was changed, Kendall's tau, and each method's place; none for one method.

        Raises
        ------
        BadInput
            If another run lacks a ranked method.
        """
        methods = compare_methods(run).ranked
        if len(methods) > 1:
            quality = _stack(run, methods, RANKING)
            methods = [one for one in methods if quality[one.label].notna().any()]
        if len(methods) < 2:
            return pd.DataFrame(columns=["ranking", "tau"])
        rankings = {"as in the tables": _adjusted(run, methods), **_rank_otherwise(run, methods)}
        for root in self.runs:
            rankings[f"run {root}"] = _adjusted(Run(root), methods)
        first = next(iter(rankings.values()))
        rows = [
            {"ranking": name, "tau": round(float(kendalltau(first, values).statistic), 12)}
            | {one.label: int(place) for one, place in zip(methods, rankdata(-values.round(12), "min"), strict=True)}
            for name, values in rankings.items()
        ]
        return pd.DataFrame(rows)


def _stack(run: Run, methods: Sequence[Method], name: str) -> pd.DataFrame:
    """Return a score, or the number that ``name`` derives from the perils, as textures by methods."""
    cells = keep_listed_textures(tabulate_cells(run))
    perils = cells[list(PERILS)].clip(lower=1e-9)
    failed = cells[RANKING].eq(0) & cells[QUALITY].isna()
    derived = {"mean": perils.mean(axis=1), "geometric": np.exp(np.log(perils).mean(axis=1))}
    values = derived[name].mask(failed, 0.0).where(cells[RANKING].notna()) if name in derived else cells[name]
    table = cells.assign(value=values).pivot_table("value", "texture", "label", dropna=False, sort=False)
    if absent := [one.label for one in methods if one.label not in table]:
        raise BadInput(f"report robustness: {run.root} has no method {absent[0]}; give runs of the same methods")
    return table[[one.label for one in methods]].dropna(how="all")


def _adjusted(run: Run, methods: Sequence[Method], name: str = RANKING) -> Floats:
    return adjust_means(_stack(run, methods, name).to_numpy(np.float64))


def _rank_otherwise(run: Run, methods: Sequence[Method]) -> dict[str, Floats]:
    """Return the number by which each method is ranked, for each other summary and each texture left out."""
    quality = _stack(run, methods, RANKING)
    columns = [quality[name].dropna().to_numpy(np.float64) for name in quality]
    rankings = {
        "geometric mean of the perils": _adjusted(run, methods, "geometric"),
        "mean of the perils": _adjusted(run, methods, "mean"),
        "median over textures": np.array([np.median(column) for column in columns]),
        "trimmed mean over textures": np.array([trim_mean(column, _TRIM) for column in columns]),
        "failures and refusals left out": _adjusted(run, methods, QUALITY),
    }
    left_out = quality.index if len(quality) > 1 else ()
    return rankings | {f"without {name}": adjust_means(quality.drop(name).to_numpy(np.float64)) for name in left_out}


def _markdown(table: pd.DataFrame) -> str:
    if table.empty:
        return "Fewer than two methods are ranked.\n"
    labels = list(table.columns[2:])
    shown = table.assign(tau="").astype(str).map(escape_markdown).assign(tau=table["tau"].map(format_number))
    lines = ["# How far the ranking depends on choices", ""]
    lines.append(pipe_table([*map(escape_markdown, table.columns)], shown.to_numpy().tolist()))
    ranges = {label: (table[label].min(), table[label].max()) for label in labels}
    settled = [f"{escape_markdown(label)} ({low})" for label, (low, high) in ranges.items() if low == high]
    moving = [f"{escape_markdown(label)} ({low} to {high})" for label, (low, high) in ranges.items() if low < high]
    lines += ["", "tau: Kendall's, with the ranking of the tables. Numbers: places."]
    lines += [f"Settled places: {', '.join(settled) or 'none'}.", f"Places that move: {', '.join(moving) or 'none'}."]
    return "\n".join(lines) + "\n"
