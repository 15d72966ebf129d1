"""A package index on loopback with packages of a few bytes, which stalls or breaks off on request."""

from __future__ import annotations

import base64
import hashlib
import io
import threading
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

STALL, CUT, GONE = "stall", "cut", "gone"
"""What may befall a package: half of it comes and then nothing; half, and the end; it is not there."""


def wheel(
    name: str, files: Mapping[str, str], requires: tuple[str, ...] = (), extras: tuple[str, ...] = ()
) -> bytes:
    """A wheel of version 1.0 with these files."""
    head = f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n"
    head += "".join(f"Requires-Dist: {each}\n" for each in requires)
    head += "".join(f"Provides-Extra: {each}\n" for each in extras)
    information = f"{name}-1.0.dist-info"
    held = {
        **files,
        f"{information}/METADATA": head,
        f"{information}/WHEEL": "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    }
    rows = []
    for path, text in held.items():
        digest = base64.urlsafe_b64encode(hashlib.sha256(text.encode()).digest()).rstrip(b"=").decode()
        rows.append(f"{path},sha256={digest},{len(text.encode())}\n")
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for path, text in held.items():
            archive.writestr(path, text)
        archive.writestr(f"{information}/RECORD", "".join(rows) + f"{information}/RECORD,,\n")
    return packed.getvalue()


class PackageIndex:
    """What it has, and what goes wrong.

    Args:
        packages: A wheel by the name of its package.

    Attributes:
        packages: A wheel by the name of its package; may be exchanged.
        trouble: What befalls the wheel of a package, by its name; GONE hides the package.
        asked: Paths that were asked for, in order.
        stalled: Set once a download hangs.
        address: Of the index, for pip and uv.
    """

    def __init__(self, packages: Mapping[str, bytes]) -> None:
        self.packages, self.trouble = dict(packages), dict[str, str]()
        self.asked: list[str] = []
        self.stalled, self._over = threading.Event(), threading.Event()
        index = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                index.answer(self)

            do_HEAD = do_GET  # noqa: N815 (its name in http.server)

            def log_message(self, *_: Any) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        self.address = f"http://127.0.0.1:{self._server.server_port}/simple"

    def answer(self, request: BaseHTTPRequestHandler) -> None:
        """Answer one question."""
        self.asked.append(request.path)
        *_, folder, name, file = ["", "", *request.path.rstrip("/").split("/")]
        package = name if folder == "files" else file
        if package not in self.packages or self.trouble.get(package) == GONE:
            request.send_error(404)
        elif file.endswith(".metadata"):
            with zipfile.ZipFile(io.BytesIO(self.packages[package])) as archive:
                self._send(request, archive.read(f"{package}-1.0.dist-info/METADATA"), "text/plain")
        elif folder == "files":
            self._send_wheel(request, package)
        else:
            link = f"/files/{package}/{package}-1.0-py3-none-any.whl"
            words = f'<a href="{link}" data-core-metadata="true">{link.rpartition("/")[2]}</a>'
            self._send(request, words.encode(), "text/html")

    def _send(self, request: BaseHTTPRequestHandler, content: bytes, kind: str, share: float = 1.0) -> None:
        request.send_response(200)
        request.send_header("Content-Type", kind)
        request.send_header("Content-Length", str(len(content)))
        request.end_headers()
        if request.command == "GET":
            request.wfile.write(content[: int(share * len(content))])
            request.wfile.flush()

    def _send_wheel(self, request: BaseHTTPRequestHandler, package: str) -> None:
        content, trouble = self.packages[package], self.trouble.get(package)
        self._send(request, content, "application/octet-stream", 0.5 if trouble else 1.0)
        if trouble == STALL and request.command == "GET":
            self.stalled.set()
            self._over.wait()

    @contextmanager
    def serving(self) -> Iterator[PackageIndex]:
        """Serve until the block ends."""
        thread = threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True)
        thread.start()
        try:
            yield self
        finally:
            self._over.set()
            self._server.shutdown()
            self._server.server_close()
