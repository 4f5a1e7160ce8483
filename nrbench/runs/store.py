"""A run on disk: its directory, the folders of its cells, their scores, and the record of its versions."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import platform
import re
import sys
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import distributions
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NotRequired, Required, cast

import psutil
from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter, ValidationError
from typing_extensions import TypedDict

from nrbench import plugins
from nrbench.errors import BadInput, strip_control
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Kind
from nrbench.storage import json_text, make_writable, read_json, remove, write_bytes, write_json
from nrbench.suites.cell import RESULTS_VERSION
from nrbench.version import read_checkout

if TYPE_CHECKING:
    from nrbench.suites.plan import Plan

RUN_FILE = "run.json"
TAIL = 1 << 16
"""Bytes at the end of a log that are read."""
FAILED = ("error", "timeout", "memory", "crash", "invalid")
"""The statuses of a failed cell; the other statuses are ``ok`` and ``refused``."""


LONGEST_TEXT = 4000
"""Characters of a message or note that are kept."""
_Number = Annotated[float, Field(ge=-1e15, le=1e15, allow_inf_nan=False)]
_Cost = Annotated[float, Field(ge=0, le=1e15, allow_inf_nan=False)]
_Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
_Vertex = Annotated[list[_Number], Field(min_length=4, max_length=4)]
_Vector = Annotated[list[_Number], Field(min_length=2, max_length=2)]


class _LatticeContent(TypedDict):
    """A lattice in a file: generating vectors and a lattice point, px."""

    __pydantic_config__ = ConfigDict(strict=True)  # type: ignore[misc]
    t1: _Vector
    t2: _Vector
    origin: _Vector


def _check_lattice(content: dict[str, Any] | None) -> dict[str, Any] | None:
    """Return the lattice of a result if it is one; raise :class:`ValueError` if not."""
    try:
        if content is not None:
            _LATTICE.validate_python(content)
            Lattice.from_dict(content)
    except BadInput as error:
        raise ValueError(str(error)) from error
    return content


_LATTICE = TypeAdapter(_LatticeContent)
_Lattice = Annotated[dict[str, Any] | None, AfterValidator(_check_lattice)]


class _TextureContent(TypedDict):
    """What is known of a texture that was drawn, see :class:`~nrbench.plugins.forms.Texture`."""

    __pydantic_config__ = ConfigDict(strict=True)  # type: ignore[misc]
    family: str
    kind: Kind | None
    regular_share: _Share | None
    region: Annotated[list[Annotated[int, Field(ge=-(2**53), le=2**53)]], Field(min_length=4, max_length=4)] | None
    lattice: _Lattice
    lattices: list[_Lattice]
    vertices: NotRequired[list[_Vertex]]


class Result(TypedDict, total=False):
    """How a synthesis or a detection ended: the content of ``result.json``.

    What a child sends and what a file holds is checked by this class: strict types, finite numbers.

    Attributes
    ----------
    status, message
        ``ok``, ``refused`` or one of :data:`FAILED`, and the reason (of a detection: why there is no lattice).
    phase
        Where the cell failed or was refused: ``load``, ``render``, ``given``, ``detect`` or ``synthesize``.
    note
        A remark of the method on its run.
    seconds, cpu_seconds, detection_seconds
        Wall and processor seconds of the synthesis, and wall seconds in which the method detected the lattice. For a
        detection, ``seconds`` are its wall seconds.
    prepare_seconds
        Wall seconds in which the method prepared for the sample, if it does.
    peak_mib
        Peak memory in addition to that of an idle worker, MiB.
    side_by_side
        1 if other cells ran at the same time, else 0.
    lattice_used
        The lattice that the method used.
    output_hash
        Hash of the output's pixels.
    made
        The size in bytes of each file that the method's outputs are in, by its path in the folder.
    texture
        What is known of a texture that was drawn.
    wall
        Wall seconds of a whole cell. They are not on disk.
    lattice, confidence, reason, vertices
        The outcome of a detection, see :class:`~nrbench.plugins.forms.FoundLattice`.
    """

    __pydantic_config__ = ConfigDict(strict=True)  # type: ignore[misc]
    status: Annotated[str, Field(pattern=f"^({'|'.join(('ok', 'refused', 'storage', *FAILED))})$")]
    message: str
    phase: str
    note: str
    seconds: _Cost
    cpu_seconds: _Cost
    detection_seconds: _Cost
    prepare_seconds: _Cost
    peak_mib: _Cost
    side_by_side: _Cost
    lattice_used: _Lattice
    output_hash: str
    made: dict[
        Annotated[str, Field(pattern=r"^[^/\x00][^\x00]*$")],
        Annotated[int, Field(ge=0, le=2**53)],
    ]
    lattice: _Lattice
    confidence: _Share | None
    reason: str
    vertices: list[_Vertex]
    texture: _TextureContent
    wall: _Cost


_RESULT = TypeAdapter(Result)


def is_result_part(content: Mapping[str, Any]) -> bool:
    """Return whether all entries of a mapping that a result may have are of the right type and range."""
    try:
        _RESULT.validate_python(dict(content))
    except ValidationError:
        return False
    return True


class ScoreContent(TypedDict, total=False):
    """The content of a score's file, see :class:`~nrbench.plugins.forms.Score`; pictures are file names."""

    __pydantic_config__ = ConfigDict(strict=True)  # type: ignore[misc]
    metric: Required[str]
    values: Required[dict[str, bool | _Number | None]]
    reasons: Required[dict[str, str]]
    records: Required[dict[str, Any]]
    pictures: Required[dict[str, Annotated[str, Field(pattern=r"^[^/\\]+$")]]]


_SCORE = TypeAdapter(ScoreContent)


class _Part:
    """An attribute that is the path of a file or folder in a cell's folder."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __get__(self, where: CellFolder, owner: type[CellFolder]) -> Path:
        return where.path / self._name


@dataclass(frozen=True)
class CellFolder:
    """One cell on disk.

    Parameters
    ----------
    path
        The folder, named by the cell's key.
    """

    path: Path

    cell_file = _Part("cell.json")
    """The cell's description."""
    result_file = _Part("result.json")
    """How the synthesis ended; once the file exists, the synthesis is never repeated."""
    sample = _Part("sample.png")
    """The sample's pixels."""
    known = _Part("known.png")
    """Which pixels of the sample count, white; there is no such file if all do."""
    again = _Part("again.png")
    """For a photograph and a reference method: a region that does not touch the sample."""
    output = _Part("output.png")
    """The output's pixels."""
    source = _Part("source.npz")
    """The source map, array ``source``."""
    extras = _Part("extras")
    """Folder of the method's extras."""
    scores = _Part("scores")
    """Folder of the scores, one file for each metric, named by the metric and its key."""
    log = _Part("log.txt")
    """What the method and the metrics printed, and tracebacks."""

    def result(self) -> Result | None:
        """Return how the synthesis ended, or None while it has not.

        A damaged file counts as none: the cell is then computed again.
        """
        content = read_json(self.result_file)
        whole = content is not None and {"status", "message"} <= set(content) and is_result_part(content)
        return strip_control(cast("Result", content)) if whole else None

    def write_result(self, result: Result) -> Result:
        """Write how the synthesis ended, and return it."""
        plain: dict[str, Any] = {**result}
        for name in {"message", "note", "reason"} & set(plain):
            plain[name] = strip_control(plain[name])[:LONGEST_TEXT]
        write_json(self.result_file, plain, durable=True)
        return cast("Result", plain)

    def lost_files(self, result: Result) -> list[str]:
        """Return the files of a result that are not in the folder any more."""
        return [name for name in result.get("made", {}) if not (self.path / name).is_file()]

    def cut_files(self, result: Result) -> list[str]:
        """Return the files of a result that are lost, or have another size than when they were written."""
        lost = self.lost_files(result)
        return lost or [
            name for name, size in result.get("made", {}).items() if (self.path / name).stat().st_size != size
        ]

    def score_file(self, metric: str) -> Path:
        """Return the file that holds a metric's score of this cell."""
        return self.scores / f"{metric_key(metric)}.json"

    def score(self, metric: str) -> ScoreContent:
        """Return a metric's score of this cell; empty where there is none yet, or its file is damaged."""
        content = read_json(self.score_file(metric)) or {}
        whole = {**content, "reasons": strip_control(content["reasons"])} if _is_score(content, metric) else {}
        return cast("ScoreContent", whole)

    def failure(self, key: str) -> str:
        """Return why a metric failed on this cell, by the key of its scores; empty if it did not, or has no score yet.

        The metric is not imported, and a score that did not fail is not parsed.
        """
        file = self.scores / f"{key}.json"
        if b'"failed:' not in (file.read_bytes() if file.is_file() else b""):
            return ""
        reasons = (read_json(file) or {}).get("reasons")
        texts = [strip_control(str(why)) for why in reasons.values()] if isinstance(reasons, dict) else []
        return next((why for why in texts if why.startswith("failed:")), "")

    def missing_scores(self, metrics: Iterable[str]) -> list[str]:
        """Return the metrics that have not scored this cell yet, or whose score is damaged."""
        return [metric for metric in metrics if not self.score(metric)]

    def failed_scores(self, metrics: Iterable[str]) -> list[Path]:
        """Return the files of the scores that failed."""
        return [self.score_file(metric) for metric in metrics if self.failure(metric_key(metric))]

    def write_failed_score(self, metric: str, reason: str) -> None:
        """Write the score of a metric that failed: None in every column, with the reason."""
        columns = plugins.build("metrics", metric).columns
        empty = {"values": dict.fromkeys(columns), "reasons": dict.fromkeys(columns, reason[:LONGEST_TEXT])}
        write_json(self.score_file(metric), {"metric": metric, **empty, "records": {}, "pictures": {}})

    def clear(self) -> None:
        """Remove what an interrupted or failed attempt left."""
        remove(self.path)

    def log_tail(self, lines: int = 12) -> str:
        """Return the log's last lines; of a long log only the end is read."""
        try:
            with self.log.open("rb") as log:
                log.seek(max(0, os.fstat(log.fileno()).st_size - TAIL))
                text = strip_control(log.read(TAIL).decode("utf-8", "replace"))
                return "\n".join(text.splitlines()[-lines:])
        except FileNotFoundError:
            return ""


def _is_score(content: Mapping[str, Any], metric: str) -> bool:
    """Return whether the content of a file is a score of a metric, with a value or a reason in each column."""
    try:
        score = _SCORE.validate_python(dict(content))
    except ValidationError:
        return False
    explained = all(value is not None or name in score["reasons"] for name, value in score["values"].items())
    return explained and set(score["values"]) == _column_names(metric)


@cache
def _column_names(metric: str) -> frozenset[str]:
    return frozenset(plugins.build("metrics", metric).columns)


@cache
def metric_key(metric: str) -> str:
    """Return the key of a metric's scores: its name with a hash of its version and parameters.

    Scores have keys of their own, so that scoring again never repeats a synthesis.
    """
    plugin = plugins.find("metrics", metric)
    parameters = plugins.parameters_of(plugins.build("metrics", metric))
    content = json.dumps([RESULTS_VERSION, metric, plugin.full_version, parameters], sort_keys=True)
    return f"{metric}-{hashlib.blake2b(content.encode(), digest_size=6).hexdigest()}"


class _Named(TypedDict):
    name: str


class _SuiteContent(TypedDict, total=False):
    metrics: list[str] | None
    texture: list[_Named]


class _SuiteEntry(TypedDict, total=False):
    content: _SuiteContent


class _CellEntry(TypedDict):
    key: Annotated[str, Field(pattern="^[0-9a-f]{8,64}$")]


class _RunContent(TypedDict, total=False):
    """What reports rely on in ``run.json``."""

    __pydantic_config__ = ConfigDict(strict=True)  # type: ignore[misc]
    suite: Required[_SuiteEntry]
    cells: Required[list[_CellEntry]]
    machine: dict[str, Any]
    versions: dict[str, Any]
    plugins: list[dict[str, Any]]


_RUN = TypeAdapter(_RunContent)


def find_strange(root: Path) -> Path | None:
    """Return the first entry below a folder that is no file and no folder: a link, a pipe or a device; None if none is.

    No link is followed. What methods have prepared for samples belongs to them, and is not looked at.
    """
    folders = [str(root)]
    while folders:
        folder = folders.pop()
        with contextlib.suppress(FileNotFoundError), os.scandir(folder) as entries:  # a run may be removing it
            for entry in entries:
                if entry.is_dir(follow_symlinks=False):
                    folders += [] if folder == str(root / "prepared") else [entry.path]
                elif not entry.is_file(follow_symlinks=False):
                    return Path(entry.path)
    return None


@dataclass(frozen=True)
class RunDirectory:
    """The directory of a run.

    Parameters
    ----------
    root
        Its path.
    """

    root: Path

    def __post_init__(self) -> None:
        object.__setattr__(self, "root", self.root.resolve())

    @property
    def cells(self) -> Path:
        """Folder of the cells."""
        return self.root / "cells"

    @property
    def lattices(self) -> Path:
        """Folder of the detections: one for each texture and detector."""
        return self.root / "lattices"

    def cell(self, key: str) -> CellFolder:
        """Return the folder of the cell with this key."""
        return CellFolder(self.cells / key)

    def lattice(self, key: str) -> CellFolder:
        """Return the folder of the detection with this key."""
        return CellFolder(self.lattices / key)

    def info(self) -> dict[str, Any]:
        """Return the content of ``run.json``.

        Raises
        ------
        BadInput
            When the directory is no run, is damaged, or holds a link, a pipe or a device.
        """
        self.check_files()
        content = read_json(self.root / RUN_FILE)
        if content is None or not (isinstance(content.get("suite"), dict) and isinstance(content.get("cells"), list)):
            if (self.root / RUN_FILE).is_file():
                raise BadInput(f"{self.root / RUN_FILE}: is damaged; run the same command again, which writes it anew")
            raise BadInput(
                f"{self.root}: is no run (it has no {RUN_FILE}); pass the directory that `nrbench run` printed"
            )
        try:
            _RUN.validate_python(content)
        except ValidationError as error:
            wrong = ".".join(map(str, error.errors()[0]["loc"]))
            raise BadInput(f"{self.root / RUN_FILE}: {wrong} is damaged; run the same command again") from None
        cells = {tuple(map(cell.get, ("key", "label", "lattice_source"))): cell for cell in content["cells"]}
        return strip_control({**content, "cells": list(cells.values())})

    def write_info(self, plan: Plan, argv: Sequence[str], metrics: Iterable[str]) -> None:
        """Write ``run.json``: the suite, the versions, the metrics, and the cells. An equal file is left unchanged."""
        suite = plan.suite
        shown = {"name": suite.name, "version": suite.version, "hash": suite.hash, "description": suite.description}
        file = self.root / RUN_FILE
        known = file.read_bytes() if file.is_file() else b""
        created = re.match(rb'\{\s*"created": "([-+:0-9TZ]{10,40})"', known)
        content = {
            "created": created[1].decode() if created else datetime.now(UTC).isoformat(timespec="seconds"),
            "suite": {**shown, "seed": suite.seed, "content": suite.model_dump(mode="json")},
            **_provenance(argv),
            "plugin_files": plugins.files(),
            "metrics": {metric: metric_key(metric) for metric in metrics},
        }
        # One cell a line, compared as text: indented or parsed, a run of many cells takes ten times the memory.
        cells = ",\n".join(json_text(cell.as_dict(), indent=None) for cell, _ in plan.cells)
        text = f'{json_text(content).removesuffix("}")},"cells": [\n{cells}\n]}}\n'.encode()
        if known != text:
            write_bytes(file, text)

    def check_files(self) -> None:
        """Raise :class:`BadInput` if the directory holds a link, a named pipe, a socket or a device."""
        strange = find_strange(self.root)
        if strange is not None:
            raise BadInput(f"{strange}: is a link, a pipe or a device; remove it (a run holds files and folders only)")

    def claim(self) -> None:
        """Make the directory, unless it holds a run already.

        Raises
        ------
        BadInput
            When the path is a file, or a directory with something else in it, or with a link, a pipe or a device, or
            one that cannot be written.
        """
        if self.root.exists() and not self.root.is_dir():
            raise BadInput(f"{self.root}: is a file; pass another --out")
        occupied = self.root.is_dir() and any(self.root.iterdir()) and not (self.root / RUN_FILE).is_file()
        if occupied and not self.cells.is_dir():
            raise BadInput(f"{self.root}: holds something that is no run; pass an empty or new directory as --out")
        self.check_files()
        reuse = f" (--reuse {self.root} takes its results)" if self.cells.is_dir() else ""
        for place in (self.root, self.cells):
            make_writable(place, f"pass another --out{reuse}")

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Keep other processes from running in this directory; the lock ends with the process, however it ends.

        Where the file system has no locks, a warning says so.

        Raises
        ------
        BadInput
            When another process runs in the directory.
        """
        with (self.root / ".lock").open("a") as lock:
            try:
                import fcntl

                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                why = f"{self.root}: another nrbench is running in it; wait, or pass another --out"
                raise BadInput(why) from None
            except (ImportError, OSError):
                why = f"{self.root}: its file system has no locks; start no second run in it at the same time"
                warnings.warn(why, RuntimeWarning, stacklevel=3)
            yield

    def copy_cells(self, other: RunDirectory, keys: Iterable[str]) -> None:
        """Copy the finished cells of another run that have these keys and no result here.

        The result comes last: without it, the cell has none. If another process removes a file meanwhile, the cell is
        left to be computed.
        """
        for key in keys:
            theirs, ours = other.cell(key), self.cell(key)
            if theirs.result() is None or ours.result() is not None:
                continue
            ours.clear()
            files = [file for file in theirs.path.rglob("*") if file.is_file() and file != theirs.result_file]
            try:
                for file in [*files, theirs.result_file]:
                    write_bytes(ours.path / file.relative_to(theirs.path), file.read_bytes())
            except FileNotFoundError:
                ours.clear()


def _provenance(argv: Sequence[str]) -> Mapping[str, Any]:
    """Return the versions of all installed packages, the plugins, the machine, and the state of the source tree."""
    installed = {str(item.metadata["Name"]).lower(): item.version for item in distributions() if item.metadata["Name"]}
    return {
        "argv": list(argv),
        "results_version": RESULTS_VERSION,
        "versions": {"python": platform.python_version(), **dict(sorted(installed.items()))},
        "plugins": [
            {"kind": kind, "name": each.name, "distribution": each.distribution, "version": each.release}
            for kind in plugins.FORMS
            for each in plugins.inventory(kind)
        ],
        "machine": {
            "system": platform.platform(),
            "processor": _processor(),
            "cores": os.cpu_count(),
            "memory_gib": round(psutil.virtual_memory().total / 2**30, 1),
        },
        "git": read_checkout(),
    }


def _processor() -> str:
    if sys.platform.startswith("linux"):
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as info:  # noqa: PTH123
            models = [line.partition(":")[2].strip() for line in info if line.startswith("model name")]
        if models:
            return models[0]
    return platform.processor() or platform.machine()
