"""Templates of report pages: whatever text they are given stays text, and errors are raised."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from softsim_core import DataError
from softsim_ros import render_page, write_page

ATTACK = """'"></script><script>alert("{{ 1 + 1 }}")</script><!--"""


def validation(**changes: Any) -> str:
    about = SimpleNamespace(about=ATTACK, source=ATTACK, licence=ATTACK)
    values = {"title": ATTACK, "about": about, "head": (ATTACK,), "errors": [(ATTACK,)], "others": False}
    return render_page("validation.html", **{**values, "data": {"sessions": [ATTACK]}, **changes})


def test_a_text_stays_a_text() -> None:
    page = validation()
    assert page.count("<script") == 2  # the data and the page's own
    assert "alert(" not in page.partition("<script")[0].replace("alert(&#34;{{ 1 + 1 }}&#34;)", "")
    data = page.partition('type="application/json">')[2].partition("</script>")[0]
    assert json.loads(data) == {"sessions": [ATTACK]}


def test_a_number_that_is_not_finite_is_no_json() -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        validation(data={"sessions": [float("nan")]})


def test_a_page_that_cannot_be_written_names_its_file(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"nowhere/page.html: cannot be written \(No such file"):
        write_page(tmp_path / "nowhere" / "page.html", "")
