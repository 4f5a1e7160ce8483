"""A lattice by three clicks on a page in the browser."""

import http.client
import json
import queue
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from urllib.parse import urlsplit

import numpy as np
import pytest

from nrbench.cli.lattice_detection import pick
from nrbench.lattice.geometry import Lattice

IMAGE = np.random.default_rng(0).random((60, 80, 1), np.float32)
CLICKS = [[10, 10], [30, 12], [12, 35]]


class Page:
    """The page of :data:`IMAGE`, and the command that waits for its answer."""

    def __init__(self, address: str, waiting: Future[Lattice]) -> None:
        self.address, self.waiting = urlsplit(address), waiting

    def ask(self, verb: str, path: str | None = None, body: object = None) -> tuple[int, str]:
        """Return the status and the text of the answer to a request."""
        connection = http.client.HTTPConnection(self.address.netloc, timeout=60)
        connection.request(verb, path or self.address.path, None if body is None else json.dumps(body))
        answer = connection.getresponse()
        return answer.status, answer.read().decode()


@pytest.fixture
def page(monkeypatch: pytest.MonkeyPatch) -> Iterator[Page]:
    """Serve the page without a desktop."""
    monkeypatch.setattr("webbrowser.open", lambda address: True)
    addresses: queue.Queue[str] = queue.Queue()
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(pick, IMAGE, addresses.put)
        page = Page(addresses.get(timeout=60), waiting)
        yield page
        if not waiting.done():
            page.ask("POST", body={"points": None})


def test_the_page_holds_the_image_and_nothing_from_elsewhere(page: Page) -> None:
    """It is served to this machine alone, contains the picture, and names no other address."""
    assert page.address.hostname == "127.0.0.1"
    status, text = page.ask("GET")
    assert status == 200 and "data:image/png;base64,iVBOR" in text
    assert "http" not in text


def test_three_clicks_give_the_lattice(page: Page) -> None:
    """The first point is the origin, the others are the ends of t1 and t2, px."""
    assert page.ask("POST", body={"points": CLICKS})[0] == 200
    lattice = page.waiting.result(timeout=60)
    assert (lattice.t1, lattice.t2, lattice.origin) == ((20, 2), (2, 25), (10, 10))


@pytest.mark.parametrize("points", [CLICKS[:2], [[0, 0], [8, 8], [16, 16]], [["x", 0]], 3, [[0, 0], [1, 0], [0, 1]]])
def test_other_points_are_refused_and_the_page_stays(page: Page, points: object) -> None:
    """The page shows why, and another answer is taken."""
    status, text = page.ask("POST", body={"points": points})
    assert status == 400 and text
    assert page.ask("POST", body={"points": CLICKS})[0] == 200
    assert page.waiting.result(timeout=60).t1 == (20, 2)


def test_without_the_token_nothing_is_shown_or_taken(page: Page) -> None:
    """Any other path is not found, and gives no answer."""
    assert page.ask("GET", "/")[0] == page.ask("POST", "/wrong", {"points": CLICKS})[0] == 404
    assert not page.waiting.done()
