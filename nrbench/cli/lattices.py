"""The verb that finds, compares and draws lattices: lattice."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

NEXT_LINE = "\n"


@click.command("lattice")
@click.argument("image", type=click.Path(path_type=Path))
@click.option("-d", "--detector", metavar="DETECTOR[:param=value,...]", help="The detector.  [default: consensus]")
@click.option("--all", "every", is_flag=True, help="Compare all detectors.")
@click.option("--pick", is_flag=True, help="Click three points in a window: a corner, the ends of t1 and t2.")
@click.option("--lattice", metavar="x1,y1,x2,y2", help="Take this lattice; with -o, to see it drawn.")
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="OVERLAY.png", help="Draw it over the image.")
@click.option(
    "--diagnostics",
    type=click.Path(path_type=Path),
    metavar="OUT.png",
    help="Draw what led the detector to its answer.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON on standard output.")
def lattice_command(
    image: Path,
    detector: str | None,
    every: bool,
    pick: bool,
    lattice: str | None,
    output: Path | None,
    diagnostics: Path | None,
    as_json: bool,
) -> int:
    """Find the lattice of IMAGE; that there is none is an answer too."""
    from nrbench.cli.outputs import check_output
    from nrbench.errors import BadInput
    from nrbench.imaging.files import read_image

    ways = {"-d": detector, "--all": every, "--pick": pick, "--lattice": lattice}
    chosen = [name for name, value in ways.items() if value not in (None, False)]
    if len(chosen) > 1:
        raise BadInput(f"{' and '.join(chosen)}: choose one of them")
    if diagnostics is not None and chosen not in ([], ["-d"]):
        raise BadInput(f"--diagnostics: shows one detector at work; leave {chosen[0]} out")
    for path in filter(None, (output, diagnostics)):
        check_output(path)
    picture = read_image(image)
    if every:
        return _compare(picture, output, as_json)
    if pick or lattice is not None:
        return _by_hand(picture, lattice, output, as_json)
    return _detect(picture, detector or "consensus", output, diagnostics, as_json)


def _by_hand(picture: Any, numbers: str | None, output: Path | None, as_json: bool) -> int:
    """Take a lattice from the user, as numbers or by clicks."""
    from nrbench.lattice.geometry import Lattice

    if numbers is None:
        from nrbench.cli.picking import pick

        lattice = pick(picture)
        numbers_then = ",".join(repr(round(float(x), 4)) for x in lattice.matrix.flat)
        click.echo(f"for other verbs: --lattice {numbers_then}", err=True)
    else:
        lattice = Lattice.parse(numbers)
    _draw(picture, lattice, output)
    answer = {"t1": list(lattice.t1), "t2": list(lattice.t2), "detector": "picked" if numbers is None else "given"}
    _say({**answer, "confidence": None}, as_json)
    return 0


def _detect(picture: Any, spec: str, output: Path | None, diagnostics: Path | None, as_json: bool) -> int:
    """Ask one detector."""
    from nrbench.api import detect_lattice
    from nrbench.plugins.forms import NoLatticeFound
    from nrbench.plugins.parameters import parse_spec

    name, parameters = parse_spec(spec)
    try:
        found = detect_lattice(picture, name, **parameters)
    except NoLatticeFound as none:
        _explain(none.best.diagnostics if none.best else {}, f"{spec}: no lattice: {none.reason}", diagnostics)
        if output is not None:
            click.echo(f"{output}: not written, there is no lattice to draw", err=True)
        print(json.dumps({"lattice": None, "reason": none.reason}) if as_json else f"no lattice: {none.reason}")
        return 0
    answer = {"t1": list(found.lattice.t1), "t2": list(found.lattice.t2), "detector": name}
    _explain(found.diagnostics, f"{spec}: {_vectors(answer)}, confidence {found.confidence:.3f}", diagnostics)
    _draw(picture, found.lattice, output)
    _say({**answer, "confidence": found.confidence}, as_json)
    return 0


def _compare(picture: Any, output: Path | None, as_json: bool) -> int:
    """Ask all detectors; one that fails is a row like any other, and makes exit code 1."""
    from nrbench import plugins
    from nrbench.jit import load_kernels

    load_kernels()
    names = [plugin.name for plugin in plugins.inventory("detectors") if plugin.cls is not None]
    found = [_asked(picture, name) for name in names]
    answers = [answer for answer, _ in found]
    if output is not None:
        _draw_sheet(picture, found, output)
    print(json.dumps(answers, indent=1) if as_json else _table(answers), end="\n" if as_json else "")
    return int(any("error" in answer for answer in answers))


def _asked(picture: Any, name: str) -> tuple[dict[str, Any], Any]:
    """Return what a detector answers, JSON-ready, and its lattice or None."""
    from nrbench import plugins
    from nrbench.errors import BadInput
    from nrbench.plugins.forms import timed_detection

    try:
        found = timed_detection(plugins.build("detectors", name), picture)
    except BadInput:
        raise
    except Exception as error:
        why = f"failed: {type(error).__name__}: {error}"
        return {"detector": name, "lattice": None, "reason": why, "error": True}, None
    if found.lattice is None:
        return {"detector": name, "lattice": None, "reason": found.reason, "seconds": found.seconds}, None
    vectors = {"t1": list(found.lattice.t1), "t2": list(found.lattice.t2)}
    return {"detector": name, **vectors, "confidence": found.confidence, "seconds": found.seconds}, found.lattice


def _table(answers: Sequence[dict[str, Any]]) -> str:
    """Return one line a detector: vectors, confidence and seconds, or why there is none."""
    head = f"{'detector':<12} {'t1 (px)':<20} {'t2 (px)':<20} {'confidence':>10} {'seconds':>8}"
    return "\n".join([head, *map(_line, answers)]) + "\n"


def _line(answer: dict[str, Any]) -> str:
    seconds = f"{answer['seconds']:.3f}" if "seconds" in answer else "-"
    if "t1" not in answer:
        why = answer["reason"] if "error" in answer else f"no lattice: {answer['reason']}"
        return f"{answer['detector']:<12} {'-':<20} {'-':<20} {'-':>10} {seconds:>8}  {why}"
    t1, t2 = (f"({answer[key][0]:.3f}, {answer[key][1]:.3f})" for key in ("t1", "t2"))
    return f"{answer['detector']:<12} {t1:<20} {t2:<20} {answer['confidence']:>10.3f} {seconds:>8}"


def _draw_sheet(picture: Any, found: Sequence[tuple[dict[str, Any], Any]], output: Path) -> None:
    """Write one captioned picture a detector."""
    from nrbench.imaging.contact_sheet import contact_sheet
    from nrbench.imaging.files import write_image
    from nrbench.imaging.overlay import overlay

    pictures = [picture if lattice is None else overlay(picture, lattice) for _, lattice in found]
    letters = max(32, picture.shape[1] // 6)
    write_image(output, contact_sheet(pictures, [_caption(answer, letters) for answer, _ in found], columns=3))


def _caption(answer: dict[str, Any], letters: int) -> str:
    if "t1" not in answer:
        lines = textwrap.wrap(answer["reason"], letters, max_lines=4, placeholder=" ...")
        return "\n".join([f"{answer['detector']}: no lattice", *lines])
    return f"{answer['detector']}, confidence {answer['confidence']:.3f}\n{_vectors(answer, between=NEXT_LINE)}"


def _vectors(answer: dict[str, Any], between: str = ", ") -> str:
    (x1, y1), (x2, y2) = answer["t1"], answer["t2"]
    return f"t1 = ({x1:.3f}, {y1:.3f}) px{between}t2 = ({x2:.3f}, {y2:.3f}) px"


def _say(answer: dict[str, Any], as_json: bool) -> None:
    sure = "" if answer["confidence"] is None else f", confidence {answer['confidence']:.3f}"
    print(json.dumps(answer) if as_json else f"{_vectors(answer)}, {answer['detector']}{sure}")


def _draw(picture: Any, lattice: Any, output: Path | None) -> None:
    """Write the lattice over its image, where that is asked for."""
    from nrbench.imaging.files import write_image
    from nrbench.imaging.overlay import overlay

    if output is not None:
        write_image(output, overlay(picture, lattice))


def _explain(diagnostics: Any, title: str, output: Path | None) -> None:
    """Write what led a detector to its answer, where that is asked for."""
    if output is None:
        return
    from nrbench.cli.detection_diagram import diagram
    from nrbench.runs.store import write_aside

    figure = diagram(diagnostics, title)
    if figure is None:
        click.echo(f"{output}: not written, the detector left nothing that can be drawn", err=True)
        return
    write_aside(output, lambda aside: figure.savefig(aside, dpi=110))
