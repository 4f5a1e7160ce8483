"""The page: its form, its safety, its pictures, and the lattices over them."""

import base64
import io
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrbench.lattice.geometry import Lattice
from nrbench.reports.html import HtmlReport
from nrbench.reports.page.gallery import (
    TextureDraw,
    begin_figures,
    build_gallery,
    list_failings,
    trace_lattice,
)
from nrbench.reports.page.pictures import PictureStore
from nrbench.reports.statistics.method_comparison import compare_methods
from nrbench.runs.records import Run
from nrbench.version import find_project

from .conftest import Make

VOID = {"meta", "img", "input", "br", "path"}


class Page(HTMLParser):
    """The elements of a page with their attributes, their text, and whether every tag is closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str]]] = []
        self.open: list[str] = []
        self.words: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note an element that is opened."""
        self.elements.append((tag, {name: value or "" for name, value in attrs}))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note an element without content."""
        self.elements.append((tag, {name: value or "" for name, value in attrs}))

    def handle_endtag(self, tag: str) -> None:
        """Check that what is closed was opened last."""
        assert self.open.pop() == tag, f"</{tag}> closes another element"

    def handle_data(self, data: str) -> None:
        """Note text that a reader sees."""
        if not {"style", "script"} & set(self.open):
            self.words.append(data)

    @property
    def text(self) -> str:
        """All text, on one line."""
        return " ".join(" ".join(self.words).split())

    def all(self, tag: str) -> list[dict[str, str]]:
        """Return the attributes of every element of a kind."""
        return [attributes for name, attributes in self.elements if name == tag]


@pytest.fixture(scope="module")
def page_text(every_ending: Run) -> str:
    """Return the written page of a run with every status."""
    (path,) = HtmlReport().write(every_ending, every_ending.root / "report")
    assert path.name == "report.html"
    return path.read_text("utf-8")


@pytest.fixture(scope="module")
def page(page_text: str) -> Page:
    """Return the parsed page."""
    return Page(page_text)


def _check_form(page: Page) -> None:
    """Check that elements are closed in order, ids occur once, links lead to elements, and titles have tooltips."""
    assert page.open == []
    ids = [attributes["id"] for _, attributes in page.elements if "id" in attributes]
    assert len(ids) == len(set(ids))
    assert {one["href"].removeprefix("#") for one in page.all("a")} <= set(ids)
    heads = [one for one in page.all("th") if one.get("scope") == "col"]
    assert len(heads) > 30 and all(one.get("title") for one in heads)


def test_pages_are_well_formed(page: Page, ranked_page: Page) -> None:
    """A page with every status and a page with a ranking are well formed; the title of a score says its unit."""
    _check_form(page)
    _check_form(ranked_page)
    titles = [one["title"] for one in page.all("th") if one.get("scope") == "col"]
    for words in ("unit: none; range: 0 to 1; better: higher", "unit: none; range: 0 to ∞; better: nearest to 1"):
        assert any(words in title for title in titles)


def test_it_loads_nothing(page: Page, page_text: str) -> None:
    """The page loads nothing: pictures are embedded, links stay on the page, and there is no other address."""
    bare = re.sub(r"data:image/webp;base64,[A-Za-z0-9+/=]+", "", page_text)
    assert not re.search(r"https?:|@import|url\((?!#)|src=\"//|href=\"//", bare)
    for tag, attributes in page.elements:
        for name in ("src", "href", "srcset", "action", "data", "poster", "xlink:href"):
            assert attributes.get(name, "#").startswith(("#", "data:image/")), (tag, name)
    assert not {"link", "iframe", "object", "embed", "base", "form"} & {tag for tag, _ in page.elements}


def test_nothing_but_its_own_script_can_run(page: Page) -> None:
    """The content policy names the style and the script by hash, and there is one of each."""
    policy = next(one["content"] for one in page.all("meta") if one.get("http-equiv"))
    assert policy.startswith("default-src 'none'")
    assert len(re.findall(r"'sha256-[A-Za-z0-9+/=]{44}'", policy)) == 2
    assert len(page.all("script")) == len(page.all("style")) == 1
    assert not [attributes for _, attributes in page.elements if "style" in attributes]


def test_every_status_is_a_row(page: Page) -> None:
    """Each status but ok has a row among the failures, and so has a metric that failed."""
    listed = [attributes["data-status"] for tag, attributes in page.elements if "data-status" in attributes]
    others = ["error", "timeout", "memory", "crash", "invalid"]
    assert listed == [*others, "refused", "missing", "unscored"]
    for status in [*others, "refused"]:
        assert f"{status} because of" in page.text
        assert f"log of {status}" in page.text
    assert "failed: KeyError: 'x'" in page.text


def test_hostile_names_stay_text(page: Page) -> None:
    """Markup in names, messages, notes, logs, versions and plugins appears as text."""
    assert all(one["src"] != "x" for one in page.all("img"))
    assert not [attributes for _, attributes in page.elements if any(name.startswith("on") for name in attributes)]
    assert page.text.count("<img src=x onerror=\"alert(1)\"> & 'co'") > 15
    assert "\x1b" not in page.text


def _decode(source: str) -> np.ndarray:
    content = base64.b64decode(source.partition(",")[2])
    return np.asarray(PIL.Image.open(io.BytesIO(content)).convert("RGB"))


@pytest.mark.parametrize("single", [False, True])
def test_large_pictures_have_a_file_or_all_pixels(
    make_cell: Make, make_run: Make, tmp_path: Path, single: bool
) -> None:
    """An output is embedded as a small copy beside its own file; in a single file it is embedded without loss."""
    record = make_cell(side=96)
    content = (record.folder / "output.png").read_bytes()
    page = Page(HtmlReport(single_file=single).render(make_run([record]), tmp_path))
    (shown,) = [one for one in page.all("img") if one.get("class", "").startswith("base")]
    same = np.array_equal(_decode(shown["src"]), np.asarray(PIL.Image.open(io.BytesIO(content)).convert("RGB")))
    assert same == single == ("data-full" not in shown)
    if not single:
        assert (tmp_path / shown["data-full"]).read_bytes() == content


def test_a_page_of_many_pictures_loads_them_from_their_folder(
    make_cell: Make, make_run: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beyond the limit the page embeds no picture, names files that exist, and says that they lie beside it."""
    run = make_run([make_cell("a", side=96), make_cell("b", side=80)])
    small = HtmlReport().render(run, tmp_path)
    monkeypatch.setattr("nrbench.reports.page.pictures.EMBEDDED", 100)
    page = HtmlReport().render(run, tmp_path)
    sources = [one["src"] for one in Page(page).all("img")]
    assert "data:image" in small and "beside this page" not in small
    assert "beside this page" in page and len(page) < len(small)
    assert sources and all(name.startswith("pictures/") and (tmp_path / name).is_file() for name in sources)


def test_a_missing_picture_is_no_error(make_cell: Make, make_run: Make, tmp_path: Path) -> None:
    """A picture that was deleted or truncated leaves a placeholder."""
    first, second = make_cell("a"), make_cell("b")
    (first.folder / "output.png").unlink()
    (second.folder / "output.png").write_bytes(b"")
    (second.folder / "sample.png").write_bytes(b"not a picture")
    page = Page(HtmlReport().render(make_run([first, second]), tmp_path))
    assert page.text.count("picture missing") == 2


def test_lattices_are_drawn_over_the_sample(page: Page) -> None:
    """The page draws the true lattice, and each different lattice that a method used."""
    classes = [one.get("class", "") for one in page.all("path")]
    assert "truth" in classes
    assert classes.count("found") == 1
    assert "lattice used by rsgf (own)" in page.text


@pytest.fixture(scope="module")
def ranked_page(ranked: Run, tmp_path_factory: pytest.TempPathFactory) -> Page:
    """Return the parsed page of a run with qualities."""
    return Page(HtmlReport().render(ranked, tmp_path_factory.mktemp("page")))


def test_outputs_say_what_limits_them(ranked_page: Page) -> None:
    """Each output shows the peril that limits its quality, except outputs of full quality and of no quality."""
    text = ranked_page.text
    assert text.count("quality limited by randomness") == 14  # close, good, copier, tiling: 3 each; refuser: 2


def test_the_weakest_outputs_of_each_method_are_shown(ranked: Run, ranked_page: Page) -> None:
    """Each ranked method has the textures on which it failed, and links to its weakest outputs; no reference."""
    found = {
        one.method.name: one for one in list_failings(compare_methods(ranked), PictureStore(ranked.root / "report"))
    }
    assert set(found) == {"good", "close", "shaky", "refuser", "drifter"}
    assert [one.texture for one in found["drifter"].lost] == ["a", "b", "c"]
    assert [one.texture for one in found["shaky"].lost] == ["a"]
    assert [one.texture for one in found["refuser"].unfinished] == ["a"]
    for one in found.values():
        qualities = [float(record.values["quality.score"] or 0) for record, _ in one.weakest]
        assert qualities == sorted(qualities) and all(crop for _, crop in one.weakest)
    assert "Lattice lost on 3 of 3 textures: a" in " ".join(ranked_page.text.split())


def test_without_tests_nothing_is_called_tied(ranked: Run, tmp_path: Path) -> None:
    """A page without tests names the highest quality, no leading group, and says that ties are not known."""
    page = Page(HtmlReport(tests=False).render(ranked, tmp_path)).text
    assert "No tests were made" in page and "★" not in page and "leading group" not in page


def test_a_run_that_is_not_complete_counts_what_was_run(make_cell: Make, make_run: Make, tmp_path: Path) -> None:
    """Textures that were not run are not counted where methods fail; their cells are one row for each texture."""
    cells = [make_cell("run", name, preserved=False, perils=0.1) for name in ("one", "two")]
    cells += [make_cell("absent", name, status="missing", replicate=i) for name in ("one", "two") for i in range(3)]
    page = Page(HtmlReport().render(make_run(cells), tmp_path))
    words = " ".join(page.text.split())
    assert "Lattice lost on 1 of 1 texture: run" in words and "6 cells not run yet" in words
    listed = [attributes["data-status"] for tag, attributes in page.elements if "data-status" in attributes]
    assert listed == ["missing"]


def _gallery(run: Run, tmp_path: Path) -> list[list[TextureDraw]]:
    pictures = PictureStore(tmp_path)
    return build_gallery(compare_methods(run), begin_figures(run, pictures), pictures)


def test_every_cell_has_a_figure(every_ending: Run, tmp_path: Path) -> None:
    """A failed cell has its figure too, without a picture."""
    figures = [figure for draws in _gallery(every_ending, tmp_path) for draw in draws for figure in draw.figures]
    assert sorted(one.record.key for one in figures) == sorted(record.key for record in every_ending.cells)
    assert all((one.output is not None) == (one.record.status == "ok") for one in figures)


def test_equal_lattices_are_drawn_once(make_cell: Make, make_run: Make, tmp_path: Path) -> None:
    """Methods that used the same lattice share a drawing, whatever its basis; the true one is not drawn again."""
    wrong, same = Lattice((9.9, 0.0), (0.0, 7.0)), Lattice((9.9, 7.0), (9.9, 0.0), (3.0, 3.0))
    cells = [make_cell(method=name, lattice_used=used) for name, used in (("a", wrong), ("b", same), ("c", None))]
    run = make_run([*cells, make_cell(method="d")])
    draw = _gallery(run, tmp_path)[0][0]
    assert [labels for labels, _ in draw.used] == [["a (own)", "b (own)"]]
    assert draw.truth is not None
    assert list(draw.agreeing) == ["d (own)"]


def _segments(path: str) -> np.ndarray:
    numbers = [float(number) for number in re.findall(r"-?[\d.]+", path)]
    return np.array(numbers).reshape(-1, 2, 2)


@settings(max_examples=40)
@given(st.floats(6, 30), st.floats(0, 3.14), st.floats(0.6, 2.5), st.floats(1.0, 2.1), st.floats(-50, 50))
def test_every_lattice_point_lies_on_two_lines(
    s: float, turn: float, ratio: float, angle: float, origin: float
) -> None:
    """Each lattice point of the image is an end or a crossing of the lines drawn."""
    ray = lambda length, at: (length * np.cos(at), length * np.sin(at))  # noqa: E731
    lattice = Lattice(ray(s, turn), ray(s * ratio, turn + angle), (origin, 3.0)).reduced()
    starts, ends = np.moveaxis(_segments(trace_lattice(lattice, (64, 48)).lines), 1, 0)
    along = (ends - starts) / np.linalg.norm(ends - starts, axis=1, keepdims=True)
    for point in lattice.points((64, 48)):
        offset = point - starts
        distance = np.abs(offset[:, 0] * along[:, 1] - offset[:, 1] * along[:, 0])
        assert (distance < 0.05).sum() >= 2


def test_the_perils_have_sections(ranked: Run) -> None:
    """The page lists methods by each peril that was measured, and links to no project while the metadata name none."""
    page = HtmlReport().render(ranked, ranked.root / "report")
    assert 'id="four-perils"' in page and page.count('id="peril-') == 4
    assert "noreferrer" not in page
    assert find_project({"git": {"commit": "a" * 40, "clean": False}})["commit_page"] == ""
