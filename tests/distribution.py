"""How workers share the tests: the longest first, all pages by one of them, what is short last."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import Any

from xdist.scheduler.loadfile import LoadFileScheduling

REPOSITORY = Path(__file__).resolve().parents[1]

PAGES = re.compile(r"^from (browser_page|driven_page) import |^from headless_browser import .*running", re.M)
"""In files whose tests open pages with WebGL: two browsers at once have no core left for their robots."""

SHARED = re.compile(r"scope=|@(lru_)?cache\b|pytest\.mark\.ros\b")
"""In files whose tests share something that is costly to make, or run processes."""

CHUNK = 8
"""Tests of other files that are shared at a time."""


class OneBrowser(LoadFileScheduling):  # type: ignore[misc]
    """Hands out pages as if they were one file, then files that share something, then the rest in chunks.

    Pages come first as they take the longest, and chunks last: what a worker does while the other one has
    nothing left is short.
    """

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._scopes: dict[str, str] = {}
        self._counts: dict[str, int] = {}

    def _split_scope(self, nodeid: str) -> str:
        """Return the group of a test, which is handed out as a whole."""
        if nodeid not in self._scopes:
            file = nodeid.partition("::")[0]
            kind = kind_of(file)
            count = self._counts[file] = self._counts.get(file, -1) + 1
            chunk = f"{file}#{count // CHUNK}" if kind == "chunks" else file
            self._scopes[nodeid] = "pages" if kind == "pages" else chunk
        return self._scopes[nodeid]

    def _assign_work_unit(self, node: Any) -> None:
        """Hand out what comes first by its kind, of these the group with the most tests."""
        kinds = ("pages", "files", "chunks")
        first = min(
            self.workqueue,
            key=lambda scope: (kinds.index(kind_of(scope.partition("#")[0])), -len(self.workqueue[scope])),
        )
        self.workqueue.move_to_end(first, last=False)
        super()._assign_work_unit(node)


@cache
def kind_of(file: str) -> str:
    """How the tests of a file are handed out: with all "pages", as a whole ("files") or in "chunks"."""
    if file == "pages":
        return file
    path = REPOSITORY / file
    text = path.read_text(encoding="utf-8")
    if PAGES.search(text):
        return "pages"
    folders = [
        folder / "conftest.py" for folder in path.parents if folder.is_relative_to(REPOSITORY / "tests")
    ]
    fixtures = [each.read_text(encoding="utf-8") for each in folders[:-1] if each.is_file()]
    return "files" if any(SHARED.search(each) for each in (text, *fixtures)) else "chunks"
