"""Serves a page on loopback, and rebuilds it when its files change."""

from __future__ import annotations

import json
import secrets
import threading
from collections.abc import Callable
from dataclasses import field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from animtool.core.errors import AnimtoolError
from animtool.core.files.reading import FileState, RecordedInputs, recorded_inputs
from animtool.core.record import dataclass
from animtool.preview.build import PreviewPage

ADDRESS = "127.0.0.1"
# Interval of checking files for changes [s].
POLL_INTERVAL = 0.1

PageBuilder = Callable[[], PreviewPage]


@dataclass(slots=True)
class WatchedPage:
    """A page and the input files that it is rebuilt from.

    Attributes:
        build_page: Builds the page.
        secret: First path component of the page's address.
        page: The last page that was built.
        version: Number of builds.
        error: Why the last build failed; None if it succeeded.
    """

    build_page: PageBuilder
    secret: str = field(default_factory=lambda: secrets.token_urlsafe(16))
    page: PreviewPage | None = None
    version: int = 0
    error: str | None = None
    _state_by_input: dict[Path, FileState | None] = field(default_factory=dict)
    _body: bytes = b""
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def build(self) -> None:
        """Build the page, and record its input files.

        Raises:
            AnimtoolError: The page cannot be built; the previous one stays.
        """
        with recorded_inputs() as inputs:
            try:
                page = self.build_page()
            except AnimtoolError as error:
                self._record_states(inputs, keep_previous=True)
                self.error = str(error)
                raise
        self._record_states(inputs, keep_previous=False)
        with self._lock:
            self.version += 1
            self.page, self.error = page, None
            watch = {"url": f"/{self.secret}/state", "version": self.version}
            self._body = b"".join(page.chunks(watch))

    def _record_states(self, inputs: RecordedInputs, *, keep_previous: bool) -> None:
        """Record the state that each input file had when it was read."""
        if not keep_previous:
            self._state_by_input.clear()
        else:
            self._state_by_input = {
                path: FileState.of(path) for path in self._state_by_input
            }
        # Files of a scene's temporary bake no longer exist.
        self._state_by_input |= {
            path: state
            for path, state in inputs.states.items()
            if state is None or path.exists()
        }

    def has_changed(self) -> bool:
        """Return whether any input file changed since it was read."""
        return any(
            FileState.of(path) != previous_state
            for path, previous_state in self._state_by_input.items()
        )

    def response_body(self) -> bytes:
        """Return the page as the body of an HTTP response."""
        with self._lock:
            return self._body

    def polled_state(self) -> bytes:
        """Return the version of the page and the last error as JSON."""
        with self._lock:
            state = {"version": self.version, "error": self.error}
        return json.dumps(state).encode()


class _Handler(BaseHTTPRequestHandler):
    """Answers requests for the page and its state that have the secret token."""

    server: PageServer
    server_version, sys_version = "animtool", ""
    protocol_version = "HTTP/1.1"
    # Timeout of clients that connect and send nothing [s].
    timeout = 30

    def do_GET(self) -> None:
        """Send the page or its state; refuse any other path."""
        watched_page, path = self.server.watched_page, self.path.partition("?")[0]
        if not self._is_authorized():
            self._send(403, b"forbidden\n", "text/plain")
        elif path == f"/{watched_page.secret}/":
            self._send(200, watched_page.response_body(), "text/html; charset=utf-8")
        elif path == f"/{watched_page.secret}/state":
            self._send(200, watched_page.polled_state(), "application/json")
        else:
            self._send(403, b"forbidden\n", "text/plain")

    def _is_authorized(self) -> bool:
        """Return whether a request has the secret token and the right host."""
        port = self.server.server_address[1]
        hosts = {f"{ADDRESS}:{port}", f"localhost:{port}"}
        if self.headers.get("Host") not in hosts:
            return False
        origin = self.headers.get("Origin")
        if origin is not None and origin not in {f"http://{host}" for host in hosts}:
            return False
        tokens = self.path.split("/")[1:2]
        secret = self.server.watched_page.secret.encode()
        return bool(tokens) and secrets.compare_digest(
            tokens[0].encode("utf-8", "replace"), secret
        )

    def _send(self, code: int, body: bytes, content_type: str) -> None:
        """Send a response that is never cached."""
        self.send_response(code)
        self.send_header("Content-Type", content_type)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("Referrer-Policy", "no-referrer")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("X-Frame-Options", "DENY")
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing: the address contains the secret."""


class PageServer(ThreadingHTTPServer):
    """HTTP server of a page on the loopback interface, at a free port."""

    daemon_threads = True

    def __init__(self, watched_page: WatchedPage) -> None:
        self.watched_page = watched_page
        super().__init__((ADDRESS, 0), _Handler)

    @property
    def address(self) -> str:
        """URL of the page."""
        return f"http://{ADDRESS}:{self.server_address[1]}/{self.watched_page.secret}/"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore connections that the browser closed."""


def rebuild_on_changes(
    watched_page: WatchedPage,
    on_error: Callable[[AnimtoolError], object],
    on_page: Callable[[PreviewPage], object],
    wait: Callable[[float], bool],
) -> None:
    """Rebuild a page whenever its files change.

    Args:
        watched_page: The page.
        on_error: Called with the error when a build fails.
        on_page: Called with each new page.
        wait: Called with an interval [s]; returns whether to stop.
    """
    while not wait(POLL_INTERVAL):
        if not watched_page.has_changed():
            continue
        try:
            watched_page.build()
        except AnimtoolError as error:
            on_error(error)
        else:
            assert watched_page.page is not None
            on_page(watched_page.page)
