"""Read a run from disk: one record for each cell, and tidy tables."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from nrbench import plugins
from nrbench.errors import BadInput
from nrbench.plugins.forms import Column, Value
from nrbench.runs.store import RUN_FILE, CellFolder, Result, RunDirectory
from nrbench.storage import read_json, write_bytes
from nrbench.suites.cell import Cell, Recipe

if TYPE_CHECKING:
    import pandas as pd

T = TypeVar("T")
HEAD = (
    *("suite", "texture", "family", "kind", "regular_share", "method", "parameters", "lattice_source", "replicate"),
    *("reference", "status", "phase", "message", "note", "seconds", "peak_mib", "key"),
)
"""The table's columns before the scores."""


@dataclass(frozen=True)
class CellRecord:
    """One cell of a run: what it is, how it ended, and its scores.

    Parameters
    ----------
    cell
        What the cell is.
    folder
        The folder of its files.
    result
        The content of ``result.json``; empty while the cell has not ended.
    values, reasons
        Every score by ``metric.column``, and the reason of each score that is None.
    pictures
        The metrics' pictures by ``metric.name``.
    records
        The metrics' further records by ``metric``.

    Examples
    --------
    >>> import tempfile
    >>> from nrbench import Options, run
    >>> folder = tempfile.mkdtemp()
    >>> done = run(
    ...     "core",
    ...     methods="scatter",
    ...     textures="brick-mild",
    ...     size="64x64",
    ...     out=folder,
    ...     options=Options(jobs=0),
    ...     metrics=["cost"],
    ... )
    >>> record = done.cells[0]
    >>> record.status
    'ok'
    """

    cell: Cell
    folder: Path
    result: Result
    values: Mapping[str, Value] = field(default_factory=dict)
    reasons: Mapping[str, str] = field(default_factory=dict)
    pictures: Mapping[str, Path] = field(default_factory=dict)
    records: Mapping[str, Any] = field(default_factory=dict)

    key = property(attrgetter("folder.name"), doc="The cell's key.")
    suite = property(attrgetter("cell.suite"), doc="Name of the suite.")
    texture = property(attrgetter("cell.texture"), doc="Name of the texture.")
    family = property(attrgetter("cell.family"), doc="Family of the texture.")
    kind = property(attrgetter("cell.kind"), doc="Kind of the texture: 0, I, II, III or stochastic.")
    regular_share = property(attrgetter("cell.regular_share"), doc="Regular share of the texture, in [0, 1].")
    method = property(attrgetter("cell.label"), doc="The method with the parameters that differ from their defaults.")
    parameters = property(attrgetter("cell.parameters"), doc="All parameters of the method.")
    reference = property(
        attrgetter("cell.reference"),
        doc="Whether the method is a reference: it calibrates the scores and is never ranked.",
    )
    lattice_source = property(attrgetter("cell.lattice_source"), doc="``given``, ``own``, ``none``, or the detector.")
    replicate = property(attrgetter("cell.replicate"), doc="Number of the draw.")

    @property
    def status(self) -> str:
        """``ok | refused | error | timeout | memory | crash | invalid``, or ``missing`` until the cell has ended."""
        return str(self.result.get("status", "missing"))

    @property
    def phase(self) -> str:
        """Where the cell failed; empty if it did not."""
        return str(self.result.get("phase", ""))

    @property
    def message(self) -> str:
        """Why the cell failed or was refused."""
        return str(self.result.get("message", ""))

    @property
    def note(self) -> str:
        """A remark of the method on its run."""
        return str(self.result.get("note", ""))

    @property
    def seconds(self) -> float | None:
        """Wall seconds of the synthesis."""
        return self.result.get("seconds")

    @property
    def peak_mib(self) -> float | None:
        """Peak memory in addition to that of an idle worker, MiB."""
        return self.result.get("peak_mib")

    @property
    def lattice_given(self) -> dict[str, Any] | None:
        """The lattice that the method received; None if it received none."""
        return self.cell.lattice_given.as_dict() if self.cell.lattice_given else None

    @property
    def lattice_truth(self) -> dict[str, Any] | None:
        """The true lattice of the sample."""
        return self.cell.lattice_truth.as_dict() if self.cell.lattice_truth else None

    @property
    def lattice_used(self) -> dict[str, Any] | None:
        """The lattice that the method used."""
        return self.result.get("lattice_used")

    @property
    def log_tail(self) -> str:
        """The last lines that the method printed."""
        return CellFolder(self.folder).log_tail()


@dataclass(frozen=True)
class Plot:
    """A plot of a run, which notebooks show.

    Parameters
    ----------
    run
        The run.
    width
        Width in inches, from 3 to 12.
    """

    run: Run
    width: float = 5.5

    def save(self, path: str | Path) -> Path:
        """Write the plot as SVG, PDF or PNG, by the ending of the path, and return the path.

        Raises
        ------
        BadInput
            For another ending.
        """
        target = Path(path)
        kind = target.suffix.lower().removeprefix(".")
        if kind not in ("svg", "pdf", "png"):
            raise BadInput(f"{path}: end the name in .svg, .pdf or .png")
        content = self._render(kind)
        write_bytes(target, content)
        return target

    savefig = save

    def _render(self, kind: str) -> bytes:
        content: bytes = plugins.build("reports", plugins.in_role("plot"), {"width": self.width}).plot(self.run, kind)
        return content

    def _repr_svg_(self) -> str:
        return self._render("svg").decode("utf-8")


@dataclass(frozen=True)
class Run:
    """A run on disk.

    A notebook shows it as the table of methods, and textures by methods with their verdicts.

    Parameters
    ----------
    root
        The run directory.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from nrbench import Options, Run, run
    >>> folder = tempfile.mkdtemp()
    >>> _ = run(
    ...     "core",
    ...     methods="scatter",
    ...     textures="brick-mild",
    ...     size="64x64",
    ...     out=folder,
    ...     options=Options(jobs=0),
    ...     metrics=["cost"],
    ... )
    >>> Run(Path(folder)).table()["status"].tolist()
    ['ok']
    """

    root: Path

    @cached_property
    def info(self) -> dict[str, Any]:
        """The content of ``run.json``: suite, argv, versions, machine, git state, the cells."""
        info = RunDirectory(self.root).info()
        known: dict[str, Any] = {}  # equal values are kept once: most cells of a run have the same
        for entry in info["cells"]:
            entry.update({name: known.setdefault(repr(value), value) for name, value in entry.items()})
        return info

    @property
    def seed_text(self) -> str:
        """The seed of the suite: ``seed 1``, or ``fresh seed 817`` if the system drew it for this run."""
        suite = self.info.get("suite", {})
        return f"{'fresh ' * bool(suite.get('content', {}).get('fresh_seed'))}seed {suite.get('seed', 'unknown')}"

    @cached_property
    def columns(self) -> dict[str, Column]:
        """The declared columns of all scores of this run, by ``metric.column``."""
        return {f"{p.name}.{name}": column for p in self._metrics for name, column in p.cls.columns.items()}  # type: ignore[union-attr]

    @cached_property
    def _metrics(self) -> list[plugins.Plugin]:
        """The metrics of this run that can be loaded: those that its suite names, or all."""
        named = self.info.get("suite", {}).get("content", {}).get("metrics")
        working = [plugin for plugin in plugins.inventory("metrics") if plugin.cls is not None]
        return [plugin for plugin in working if not named or plugin.name in named]

    @cached_property
    def cells(self) -> list[CellRecord]:
        """Every cell of the run, in the suite's order, including cells that have not ended."""
        directory = RunDirectory(self.root)
        metrics, recipes = [plugin.name for plugin in self._metrics], dict[int, Recipe]()
        return [_record(directory.cell(entry["key"]), entry, metrics, recipes) for entry in self.info["cells"]]

    def ends(self) -> list[CellRecord]:
        """Return every cell with how it ended, but without its scores. No metric is imported.

        The ``reasons`` hold only why metrics failed, by their names.

        Returns
        -------
        list of CellRecord
            One for each cell.
        """
        directory, keys = RunDirectory(self.root), self.info.get("metrics")
        if not isinstance(keys, dict) or any(Path(str(key)).name != key for key in keys.values()):
            return self.cells  # an earlier nrbench wrote the run, or the file is damaged
        recipes: dict[int, Recipe] = {}
        return [_end(directory.cell(entry["key"]), entry, keys, recipes) for entry in self.info["cells"]]

    def shared(self, make: Callable[..., T], *arguments: Hashable) -> T:
        """Return ``make(self, *arguments)``, computed at the first call and kept for all reports of this run.

        Parameters
        ----------
        make
            A function of the run.
        *arguments
            Its further arguments.

        Returns
        -------
        Any
            What ``make`` returned.
        """
        known = vars(self).setdefault("_shared", {})
        if (make, arguments) not in known:
            known[make, arguments] = make(self, *arguments)
        found: T = known[make, arguments]
        return found

    def table(self) -> pd.DataFrame:
        """Return the tidy table: one row for each cell, one column for each score.

        Returns
        -------
        pandas.DataFrame
            The columns :data:`HEAD`, then the scores by ``metric.column``.
        """
        import pandas as pd

        rows = [tuple(_row(record, self.columns).values()) for record in self.cells]
        return pd.DataFrame(rows, columns=[*HEAD, *self.columns])

    def comparison(self) -> pd.DataFrame:
        """Return textures by methods: the verdict and the quality of each method on each texture.

        Returns
        -------
        pandas.DataFrame
            One row for each texture.
        """
        return self._tables()["comparison"].set_index("texture")

    def summary(self) -> pd.DataFrame:
        """Return one row for each method: rank, counts, success rate and means, with 95 % intervals.

        Returns
        -------
        pandas.DataFrame
            Its index is the method and the source of the lattice.
        """
        return self._tables()["summary"].set_index(["method", "lattice_source"])

    def plot(self, width: float = 5.5) -> Plot:
        """Return the perils plane, in which each method is a point.

        Parameters
        ----------
        width
            Width in inches, from 3 to 12.

        Returns
        -------
        Plot
            A notebook shows it; its method ``save``, also called ``savefig``, writes it.

        Examples
        --------
        In a notebook, ``run.plot()`` as the last line of a cell shows it; ``run.plot().save("plane.pdf")`` writes it.
        """
        return Plot(self, width)

    def _tables(self) -> dict[str, pd.DataFrame]:
        tables: dict[str, pd.DataFrame] = plugins.build("reports", plugins.in_role("tables")).tables(self)
        return tables

    def _repr_html_(self) -> str:
        """Return the methods, and textures by methods, as HTML tables with marks, for notebooks."""
        return str(plugins.build("reports", plugins.in_role("tables")).notebook(self))


def _read_cell(where: CellFolder, entry: Mapping[str, Any], known: dict[int, Recipe]) -> Cell:
    """Return a cell of ``run.json``, with the lattice that was found for it after the plan was made.

    Cells of one sample share its recipe: ``known`` has those that were read.
    """
    started = read_json(where.cell_file) or entry
    for found in (started, entry):
        with contextlib.suppress(AttributeError, KeyError, TypeError, ValueError):
            place = id(entry["recipe"])
            recipe = known[place] = known.get(place) or Recipe.from_dict(entry["recipe"])
            lattices = {name: found.get(name) for name in ("lattice_given", "detected")}
            return Cell.from_dict({**entry, "recipe": recipe, **lattices})
    raise BadInput(f"{where.path.parents[1]}: {RUN_FILE} is damaged; run the same command again")


def _record(where: CellFolder, entry: Mapping[str, Any], metrics: list[str], recipes: dict[int, Recipe]) -> CellRecord:
    cell = _read_cell(where, entry, recipes)
    result = where.result() or Result()
    scores = {metric: where.score(metric) for metric in metrics} if result.get("status") == "ok" else {}
    return CellRecord(
        cell,
        where.path,
        result,
        {f"{m}.{column}": value for m, score in scores.items() for column, value in score.get("values", {}).items()},
        {f"{m}.{column}": why for m, score in scores.items() for column, why in score.get("reasons", {}).items()},
        {
            f"{m}.{t}": where.scores / name
            for m, score in scores.items()
            for t, name in score.get("pictures", {}).items()
        },
        {metric: score.get("records", {}) for metric, score in scores.items()},
    )


def _end(
    where: CellFolder, entry: Mapping[str, Any], keys: Mapping[str, str], recipes: dict[int, Recipe]
) -> CellRecord:
    result = where.result() or Result()
    failed = {metric: where.failure(key) for metric, key in keys.items()} if result.get("status") == "ok" else {}
    reasons = {metric: why for metric, why in failed.items() if why}
    return CellRecord(_read_cell(where, entry, recipes), where.path, result, reasons=reasons)


def _row(record: CellRecord, columns: Mapping[str, Column]) -> dict[str, Any]:
    row = {name: getattr(record, name) for name in HEAD}
    row["parameters"] = json.dumps(dict(record.parameters), sort_keys=True)
    return {**row, **{name: record.values.get(name) for name in columns}}
