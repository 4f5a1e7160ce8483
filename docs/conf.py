"""The documentation as a site: the pages of this folder, and the docstrings of the public names."""

from __future__ import annotations

from importlib.metadata import version as installed_version
from pathlib import Path

from sphinx.application import Sphinx

project = "nrbench"
author = copyright = "The nrbench developers"
version = release = installed_version("nrbench")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.extlinks",
    "sphinx.ext.viewcode",
    "numpydoc",
    "sphinx_copybutton",
]
extlinks = {"DOI": ("https://doi.org/%s", "doi:%s")}
HAS_GALLERY = any((Path(__file__).parent / "gallery" / "perils").glob("*.md"))
"""Whether ``benchmarks/gallery.py`` has written its pages to the end."""
exclude_patterns = ["_build", *([] if HAS_GALLERY else ["gallery"])]
myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 3
suppress_warnings = ["myst.header"]

autodoc_typehints = "none"
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
numpydoc_validation_checks = {"GL03", "GL06", "GL07", "GL08", "PR01", "PR02", "PR03", "PR06", "PR10", "SS01", "YD01"}
# Methods of these classes say all in one sentence; the forms of plugins have no constructor.
numpydoc_validation_exclude = {r"\.__", r"\.Lattice\.", r"\.Deformation\.", r"\.Score\.", r"\.plugins\.forms\."}

html_theme = "pydata_sphinx_theme"
html_title = f"nrbench {version}"
html_theme_options = {
    "show_toc_level": 2,
    "navigation_with_keys": True,
    "secondary_sidebar_items": ["page-toc"],
    "header_links_before_dropdown": 5,
}
html_show_sourcelink = False
html_static_path = ["static"]
html_css_files = ["gallery.css"]


def leave_out_missing_gallery(app: Sphinx, page: str, text: list[str]) -> None:
    """Leave out the lists of the gallery's pages where there are none."""
    if page == "user" and not HAS_GALLERY:
        text[0] = text[0].partition("## Gallery")[0]


def setup(app: Sphinx) -> None:
    """Connect to Sphinx."""
    app.connect("source-read", leave_out_missing_gallery)
