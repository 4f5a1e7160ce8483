"""The command site, which compares runs on a static site."""

from __future__ import annotations

from pathlib import Path

import click

_PATH = click.Path(path_type=Path)


@click.command("site")
@click.argument("runs", nargs=-1, required=True, type=_PATH, metavar="RUN...")
@click.option("-o", "--output", required=True, type=_PATH, metavar="DIR", help="Directory of the pages.")
def site_command(runs: tuple[Path, ...], output: Path) -> None:
    """Write a static site that compares RUNs, such as those of several people.

    It has a leaderboard with a filter and a page for each method. Each row names the versions, the seed and the
    machine; rows of fresh seeds are marked. The pages work from a folder and from any web server.
    """
    from nrbench.api.runs import site

    for path in site(runs, output):
        print(path)
