"""Plugins: their registry, their parameters, and their forms (protocols)."""

from nrbench.plugins.registry import (
    FORMS,
    PATCH_TERMS,
    Form,
    NamedDetector,
    Plugin,
    add_file,
    build,
    fault,
    files,
    find,
    inventory,
    name_of,
    names,
    parameters_of,
)

__all__ = [
    "FORMS",
    "PATCH_TERMS",
    "Form",
    "NamedDetector",
    "Plugin",
    "add_file",
    "build",
    "fault",
    "files",
    "find",
    "inventory",
    "name_of",
    "names",
    "parameters_of",
]
