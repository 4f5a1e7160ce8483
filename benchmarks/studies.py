"""The command lines of benchmarks: options that are read by their defaults, and studies that are run by name."""

import argparse
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any

from unit import cpu_unit

from nrbench.jit import load_kernels

Options = argparse.Namespace


def read_options(
    page: str | None, /, words: Collection[str] = (), choices: Mapping[str, Iterable[Any]] = {}, **defaults: Any
) -> Options:
    """Return the options of a command line.

    Parameters
    ----------
    page
        The docstring of the script, which is shown as help.
    words
        Those of the defaults that take the words which follow no option, in this order.
    choices
        The values that an option may have.
    **defaults
        Each option with its default. The default says what the option takes: nothing if it is False, any number of
        values of the type of the first one if it is a list (of texts if the list is empty), else one value.
    """
    parser = argparse.ArgumentParser(description=page, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in defaults.items():
        many = isinstance(default, list)
        first = next(iter(default), "") if many else default
        given: dict[str, Any] = {"action": "store_true"}
        nargs = "*" if many else "?" if name in words else None
        if default is not False:
            given = {"default": default, "type": type(first), "choices": choices.get(name), "nargs": nargs}
        parser.add_argument(name if name in words else f"--{name}", **given)
    return parser.parse_args()


def run_studies(page: str | None, *studies: Callable[[Options], None], **more: Any) -> None:
    """Print w, and run the studies that the command line names, or all.

    The name of a study is that of its function after the first word. Further options are as for :func:`read_options`.
    """
    known = {study.__name__.partition("_")[2]: study for study in studies}
    choices = {**more.pop("choices", {}), "studies": [*known, []]}
    options = read_options(page, ["studies"], choices, studies=[], **more)
    load_kernels()
    print(f"w = {cpu_unit() * 1e3:.2f} ms")
    for name in options.studies or known:
        print(f"\n{name}")
        known[name](options)
