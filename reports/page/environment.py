"""The templates of reports, and the functions that they call."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jinja2

from ..statistics import format as text_format
from ..statistics import verdicts

_FORMATS = (
    *("format_number", "format_percent", "format_value", "format_signed", "format_interval", "format_count"),
    *("format_successes", "format_limit", "describe_direction", "describe_column", "pluralize"),
)


def make_environment(filters: Mapping[str, Callable[..., Any]], **options: Any) -> jinja2.Environment:
    """Return the templates of reports as Jinja reads them.

    Parameters
    ----------
    filters
        Filters of one format, beside those that format numbers and columns.
    options
        Further options of Jinja.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent / "templates"),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        **options,
    )
    environment.globals["verdicts"] = verdicts
    environment.filters.update({name: getattr(text_format, name) for name in _FORMATS}, **filters)
    return environment
