"""A page in the browser on which a lattice is picked by three clicks."""

from __future__ import annotations

import base64
import contextlib
import json
import os
import secrets
import sys
import webbrowser
from collections.abc import Callable, Iterator, Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer  # noqa: TID251 - it listens, and connects to nothing
from importlib.resources import files

from nrbench.errors import BadInput
from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice, Vector, require_visible
from nrbench.pictures.files import encode_png

POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'; connect-src 'self'"
MOST_BYTES = 10_000
"""Size of the largest answer that is read."""


def lattice_of(points: Sequence[Vector]) -> Lattice:
    """Return the lattice of three points (x, y) px: its origin, the end of t1, the end of t2.

    Raises
    ------
    BadInput
        When the points lie on one line, or so close together that no pixel shows the period.
    """
    (x, y), (x1, y1), (x2, y2) = points
    return require_visible(Lattice((x1 - x, y1 - y), (x2 - x, y2 - y), (x, y)), "picked")


def pick(image: Image, announce: Callable[[str], None]) -> Lattice:
    """Serve a page on this machine until the user picks a lattice on it, and return the lattice.

    Only this machine can reach the page, and only with the token that is part of its address. On a desktop, the page is
    opened.

    Parameters
    ----------
    image
        The texture.
    announce
        Is called with the address of the page.

    Raises
    ------
    BadInput
        If the user cancels.
    """
    with PickServer(image) as server:
        announce(server.address)
        if sys.platform in ("darwin", "win32") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
            webbrowser.open(server.address)
        server.serve_forever(poll_interval=0.1)
    if server.lattice is None:
        raise BadInput("--pick: cancelled, no lattice was picked")
    return server.lattice


class PickServer(ThreadingHTTPServer):
    """Serves the page of one image to this machine, and takes the answer.

    Parameters
    ----------
    image
        The texture.

    Attributes
    ----------
    address
        The address of the page.
    lattice
        The lattice; None before the answer, and if the user cancelled.
    """

    def __init__(self, image: Image) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        page = files(__package__).joinpath("templates/pick.html").read_text("utf-8")
        self.page = page.replace("IMAGE", base64.b64encode(encode_png(image)).decode("ascii")).encode()
        self.path = f"/{secrets.token_urlsafe(16)}"
        self.address = f"http://127.0.0.1:{self.server_port}{self.path}"
        self.lattice: Lattice | None = None

    def answer(self, text: bytes) -> str:
        """Take the answer of the page, and return what the page shows.

        Raises
        ------
        BadInput
            If it is no lattice.
        """
        try:
            points = json.loads(text)["points"]
            self.lattice = None if points is None else lattice_of([(float(x), float(y)) for x, y in points])
        except (ValueError, TypeError, KeyError) as error:
            raise BadInput(f"no three points: {error}") from None
        return "Cancelled." if points is None else "The lattice is printed in the terminal. You can close this page."


class _Handler(BaseHTTPRequestHandler):
    """Answers the requests of the page; all others get a 404."""

    server: PickServer

    def do_GET(self) -> None:
        """Send the page."""
        with self._of_page():
            self._send(200, "text/html; charset=utf-8", self.server.page)

    def do_POST(self) -> None:
        """Take the answer."""
        with self._of_page():
            size = int(self.headers.get("Content-Length") or 0)
            if not 0 < size <= MOST_BYTES:
                raise BadInput(f"an answer of {size} bytes; at most {MOST_BYTES} are read")
            text = self.server.answer(self.rfile.read(size))
            self._send(200, "text/plain; charset=utf-8", text.encode())
            self.server.shutdown()

    @contextlib.contextmanager
    def _of_page(self) -> Iterator[None]:
        """Send 404 instead if the path is not that of the page, and 400 with the message after bad input."""
        try:
            if not secrets.compare_digest(self.path.encode(), self.server.path.encode()):
                raise FileNotFoundError
            yield
        except FileNotFoundError:
            self._send(404, "text/plain", b"not found")
        except (BadInput, ValueError) as error:
            self._send(400, "text/plain; charset=utf-8", str(error).encode())

    def _send(self, status: int, kind: str, content: bytes) -> None:
        self.send_response(status)
        for name, value in (
            ("Content-Type", kind),
            ("Content-Length", str(len(content))),
            ("Content-Security-Policy", POLICY),
            ("Cache-Control", "no-store"),
        ):
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_: object) -> None:
        """Log nothing."""
