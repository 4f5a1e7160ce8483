"""The verb that writes textures as pictures: render."""

from __future__ import annotations

from pathlib import Path

import click


@click.command("render")
@click.argument("what", metavar="MODEL[:param=value,...]|SUITE")
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), metavar="DIR")
@click.option("-t", "textures", multiple=True, metavar="GLOB", help="Only these textures of a suite; repeatable.")
@click.option("--sample", "--size", "sample", metavar="WxH", help="Size of the pictures.")
@click.option("--seed", type=click.IntRange(0), help="Seed.")
@click.option("--replicates", type=click.IntRange(1), help="Draws of each texture.")
def render_command(
    what: str, output: Path, textures: tuple[str, ...], sample: str | None, seed: int | None, replicates: int | None
) -> None:
    """Write the textures of a model or a suite as PNG, with truth.csv, truth.json and a contact sheet beside them.

    What an earlier render left in DIR stays; a picture of the same name is drawn anew.
    """
    from nrbench.api import changed
    from nrbench.suites.plan import drawn
    from nrbench.suites.rendering import model_suite, write_textures
    from nrbench.suites.suite import builtin, load_suite

    suite = load_suite(what) if what in builtin() or Path(what).exists() else model_suite(what)
    suite = changed(suite, sample=sample, seed=seed, replicates=replicates)
    for path in write_textures(drawn(suite, textures), output):
        click.echo(path)
