"""How test files are shared among workers: what opens pages is found by what it imports, not by its name."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("xdist")

from distribution import kind_of

TESTS = Path(__file__).resolve().parents[1]


def test_files_that_open_pages_go_to_one_worker() -> None:
    files = [path for path in TESTS.rglob("test_*.py") if path != Path(__file__)]
    opening = {
        path for path in files if "BrowserPage(" in (text := path.read_text()) or "browser: Any" in text
    }
    assert len(opening) > 5
    assert all(kind_of(str(path.relative_to(TESTS.parent))) == "pages" for path in opening)


@pytest.mark.parametrize(
    ("file", "kind"),
    [
        ("viewer/test_buttons.py", "pages"),  # by a helper
        ("viewer/test_guard.py", "files"),  # its folder has fixtures of processes
        ("ros/test_client.py", "files"),
        ("unit/test_distribution.py", "chunks"),
    ],
)
def test_other_files_are_whole_where_their_tests_share_something(file: str, kind: str) -> None:
    assert kind_of(f"tests/{file}") == kind
