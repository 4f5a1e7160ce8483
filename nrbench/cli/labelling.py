"""The verb that asks people: label."""

from __future__ import annotations

from pathlib import Path

import click


@click.command("label")
@click.argument("run", type=click.Path(path_type=Path))
@click.option(
    "-o", "output", type=click.Path(path_type=Path), metavar="FILE.html", help="The page.  [default: RUN/labels/...]"
)
@click.option(
    "--repeat",
    type=click.FloatRange(0, 1),
    default=0.1,
    show_default=True,
    metavar="SHARE",
    help="Share of the outputs that are shown twice.",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of order and names.")
def label_command(run: Path, output: Path | None, repeat: float, seed: int) -> None:
    """Write a page on which people label the outputs of RUN blind; `report RUN --labels` reads what they save."""
    from nrbench.errors import BadInput
    from nrbench.labelling.label_page import label_page
    from nrbench.labelling.labels import make_sheet, write_key
    from nrbench.runs.records import Run
    from nrbench.runs.store import write_aside

    if output is not None and output.suffix.lower() not in (".html", ".htm"):
        raise BadInput(f"{output}: the page is HTML; end the name in .html")
    if output is not None and not output.absolute().parent.is_dir():
        raise BadInput(f"{output}: its directory does not exist; make it first")
    sheet = make_sheet(Run(run), repeat, seed)
    path = output or sheet.key_file(run).with_suffix(".html")
    page = label_page(run, sheet)
    key = write_key(run, sheet)
    write_aside(path, lambda aside: aside.write_text(page, "utf-8"))
    twice = sum(item.again for item in sheet.items)
    print(f"{path}\n{len(sheet.items)} items, {twice} of them second showings; the key {key} stays with the run")
