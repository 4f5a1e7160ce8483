"""The page in a real browser."""

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from nrbench.reports.html import HtmlReport

from .conftest import cell_maker, run_maker

sync_api = pytest.importorskip("playwright.sync_api", reason="needs playwright, of the extra test")
axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="needs axe-playwright-python, of extra test")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")

Open = Callable[..., Any]


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the page of a run with three methods, a reference, two replicates, a refusal and hostile names."""
    root = tmp_path_factory.mktemp("browser") / "run"
    make = cell_maker(root)
    levels = {"good": 0.8, "middle": 0.5, "bad <b>name</b>": 0.2}
    cells = [
        make(texture, method, replicate=replicate, side=96, perils=quality - 0.01 * i)
        for i, texture in enumerate(("brick", "weave"))
        for method, quality in levels.items()
        for replicate in range(2)
    ]
    cells += [make(t, "oracle", "none", reference=True, side=96, perils=1.0) for t in ("brick", "weave")]
    cells.append(make("hexagon", "good", status="refused", message="too small"))
    (path,) = HtmlReport().write(run_maker(root)(cells), root / "report")
    return path


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Return a headless browser."""
    with sync_api.sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield started
        started.close()


@pytest.fixture
def visit(browser: Any, report: Path) -> Iterator[Open]:
    """Return a function that opens the page; afterwards it must have had no error and left no request."""
    contexts, faults, requests = [], [], []

    def start(width: int = 1440, scheme: str = "light", **more: Any) -> Any:
        context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme, **more)
        contexts.append(context)
        page = context.new_page()
        page.on(
            "console", lambda message: faults.append(message.text) if message.type in ("error", "warning") else None
        )
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.on("request", lambda request: requests.append(request.url))
        page.goto(report.as_uri())
        return page

    yield start
    for context in contexts:
        context.close()
    assert not faults
    folder = report.parent.as_uri()
    assert all(url.startswith((folder, "data:", "blob:")) for url in requests)


def _methods(page: Any) -> list[str]:
    return page.locator("#methods tbody tr:visible th .method").all_inner_texts()


def test_columns_sort(visit: Open) -> None:
    """A click on a title sorts the best first, a second one the worst first; references stay below."""
    page = visit()
    head = page.locator("#methods thead th", has_text="quality").first
    assert [name.split(" ")[0] for name in _methods(page)] == ["good", "middle", "bad", "oracle"]
    head.locator("button").click()
    assert head.get_attribute("aria-sort") == "descending"
    head.locator("button").press("Enter")
    assert head.get_attribute("aria-sort") == "ascending"
    assert [name.split(" ")[0] for name in _methods(page)] == ["bad", "middle", "good", "oracle"]


def test_filters_hide_rows(visit: Open) -> None:
    """The filters hide methods, and textures in the comparison and the gallery."""
    page = visit()
    page.fill("#method-filter", "midd")
    assert _methods(page) == ["middle"]
    page.fill("#filter", "weave")
    assert page.locator("#gallery article:visible").count() == 1
    assert page.locator(".comparison tbody tr:visible").count() == 1


def test_replicates_switch(visit: Open) -> None:
    """One replicate is visible at a time; a link to an output shows its replicate."""
    page = visit()
    article = page.locator("#gallery article").first
    assert article.locator(".draw:visible").get_attribute("data-replicate") == "0"
    article.get_by_role("button", name="replicate 1").click()
    assert article.locator(".draw:visible").get_attribute("data-replicate") == "1"
    hidden = article.locator(".draw").first.locator("figure.output").first.get_attribute("id")
    page.evaluate("name => { location.hash = name; }", hidden)
    sync_api.expect(article.locator(".draw:visible")).to_have_attribute("data-replicate", "0")


def test_no_column_is_cut_on_a_desktop(visit: Open) -> None:
    """At 1425 px, which a scroll bar leaves of 1440, no table of methods scrolls; on a phone each method is a card."""
    page = visit(1425)
    for name in ("#summary", "#comparison"):
        box = page.locator(f"{name} .scroll").first
        assert box.evaluate("one => one.scrollWidth <= one.clientWidth")
    phone = visit(390)
    inside = "one => one.getBoundingClientRect().right <= innerWidth"
    cells = phone.locator("#methods tbody td:visible")
    assert cells.count() >= 20 and all(cells.nth(i).evaluate(inside) for i in range(cells.count()))


def test_pictures_zoom_and_move_together(visit: Open) -> None:
    """Zoom and movement of one picture are those of all pictures of the texture, which then have all their pixels."""
    page = visit()
    article = page.locator("#gallery article").first
    views = article.locator(".draw:visible .view")
    views.last.focus()
    page.keyboard.press("+")
    page.keyboard.press("ArrowRight")
    shifts = {views.nth(i).locator(".pan").evaluate("one => one.style.transform") for i in range(views.count())}
    assert all("scale(2)" in shift for shift in shifts)
    stacks = article.locator(".draw:visible .stack .pan")
    assert len({stacks.nth(i).evaluate("one => one.style.transform") for i in range(stacks.count())}) == 1
    image = stacks.first.locator("img").first
    assert "pictures/" in image.get_attribute("src")
    image.evaluate("one => one.decode()")
    assert image.evaluate("one => one.naturalWidth") == 96
    before = stacks.first.evaluate("one => one.style.transform")
    box = views.last.bounding_box()
    page.mouse.move(box["x"] + 60, box["y"] + 60)
    page.mouse.down()
    page.mouse.move(box["x"] + 90, box["y"] + 80, steps=4)
    page.mouse.up()
    assert stacks.first.evaluate("one => one.style.transform") != before
    assert article.locator("figure.large").count() == 0
    article.get_by_role("button", name="reset").click()
    assert stacks.first.evaluate("one => one.style.transform") == ""


@pytest.mark.parametrize(("width", "scheme"), [(1440, "light"), (390, "dark")])
def test_everyone_can_use_it(visit: Open, width: int, scheme: str) -> None:
    """Axe finds no violation that is serious or critical, color contrast included."""
    page = visit(width, scheme)
    page.check("#all-columns")
    found = axe.Axe().run(page).response["violations"]
    serious = [one for one in found if one["impact"] in ("serious", "critical")]
    assert not serious, [(one["id"], [node["html"][:160] for node in one["nodes"][:3]]) for one in serious]


def test_it_can_be_read_without_script(visit: Open) -> None:
    """Without script all replicates are shown, tables are complete, and layers still toggle."""
    page = visit(java_script_enabled=False)
    assert page.locator("#gallery .draw:visible").count() == page.locator("#gallery .draw").count()
    assert page.locator("#methods tbody tr:visible").count() == 4
    assert not page.locator(".zoom").first.is_visible()
    page.check(".layers input >> nth=1")
    assert page.locator(".layer:visible").count() > 0
