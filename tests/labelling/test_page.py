"""The labelling page in a real browser."""

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from nrbench.labelling.labels import make_page, page_html, read_labels, write_key
from nrbench.runs.records import Run

sync_api = pytest.importorskip("playwright.sync_api", reason="needs playwright, of the extra test")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")


class Labeller:
    """A person in front of a labelling page."""

    def __init__(self, context: Any, run: Run, **choices: Any) -> None:
        self.run, self.label_page = run, make_page(run, **choices)
        write_key(run.root, self.label_page)
        file = run.root / "page.html"
        file.write_text(page_html(run.root, self.label_page), "utf-8")
        self.page = context.new_page()
        self.page.goto(file.as_uri())

    def press(self, *keys: str) -> None:
        """Press keys, each when the pictures of the item are shown: the page takes no answer before."""
        for key in keys:
            self.page.wait_for_function("() => since !== Infinity")
            self.page.keyboard.press(key)

    def count(self, words: str) -> None:
        """Wait until the page counts items and answers in these words."""
        sync_api.expect(self.page.locator("#count")).to_have_text(words)

    def reopen(self) -> None:
        """Close the page and open it again, after the browser has stored the answers where another page reads them."""
        stored = self.page.evaluate("() => JSON.stringify(localStorage)")
        other = self.page.context.new_page()
        other.goto(self.page.url)
        other.wait_for_function("stored => JSON.stringify(localStorage) === stored", arg=stored)
        self.page.close()
        other.reload()
        self.page = other

    def save(self, folder: Path) -> pd.DataFrame:
        """Save the answers under the name ada, and read them."""
        self.page.fill("#who", "ada")
        with self.page.expect_download() as download:
            self.page.click("#save")
        path = folder / download.value.suggested_filename
        assert path.name == f"labels-{self.label_page.name}-ada.csv"
        download.value.save_as(path)
        return read_labels(self.run, [path])


@pytest.fixture
def label(run: Run) -> Iterator[Callable[..., Labeller]]:
    """Return a function that opens a page of the run."""
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        context = browser.new_context(viewport={"width": 1280, "height": 900})
        yield lambda **choices: Labeller(context, run, **choices)
        browser.close()


def test_keys_label(label: Callable[..., Labeller], tmp_path: Path) -> None:
    """Keys answer, the arrow goes back to correct, the page resumes after it was closed, and the saved file is read."""
    labeller = label(repeat=0.25, questions=["lattice"])
    labeller.press("Enter", "1", "2", "2", "ArrowLeft", "3")
    labeller.count("4 of 15, 3 answered")
    labeller.reopen()
    labeller.press("Enter")
    labeller.count("4 of 15, 3 answered")
    labeller.press(*"1" * 12)
    labeller.count("15 of 15 answered")
    labels = labeller.save(tmp_path)
    assert labels["answer"].tolist() == ["yes", "no", "cannot say"] + ["yes"] * 12
    assert labels["order"].tolist() == list(range(1, 16))
    assert labels["seconds"].between(0, 60, inclusive="left").all()
