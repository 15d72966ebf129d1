"""How the tests are shared among workers: by file, and all pages in a browser to one worker."""

from __future__ import annotations

import re
from typing import Any

from xdist.scheduler.loadfile import LoadFileScheduling

PAGES = re.compile(r"tests/viewer/|_pages?\.py$")
"""Files whose tests may draw by software: two browsers at once have no core left for their robots."""


class OneBrowser(LoadFileScheduling):  # type: ignore[misc]
    """Files as `--dist=loadfile` shares them, and the pages as if they were one file: it is the longest."""

    def _split_scope(self, nodeid: str) -> str:
        file: Any = super()._split_scope(nodeid)
        return "pages" if PAGES.search(file) else str(file)
