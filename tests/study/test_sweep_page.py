"""The report of a store: one page that loads nothing, with surfaces that are fitted well."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from headless_browser import chromium_path

from softsim_core.base import StudyError
from softsim_core.lab.study import StudyResults, response_surface
from softsim_ros import write_page
from softsim_ros.cli import command
from softsim_ros.cli.studies import page, sweep


def results(runs: int = 30, failed: int = 2) -> StudyResults:
    drawn = np.random.default_rng(3).random((runs, 3))
    height = 1.0 + 2.0 * drawn[:, 0] - drawn[:, 1] ** 2
    status = np.ones(runs, dtype=np.int64)
    errors = [""] * runs
    for k in range(failed):
        status[k], height[k], errors[k] = 2, np.nan, "diverged <b>here</b>"
    variables = {"soft": drawn[:, 0], "wide": drawn[:, 1], "same": np.full(runs, 5.0)}
    study = {"name": "a <study>", "about": "about & more", "scene": "tripod"}
    return StudyResults(
        Path("s.zarr"),
        {"study": study, "study_text": "name: <x>\n"},
        variables,
        {"height": height, "force": height * 3.0},
        {"soft": "Pa", "wide": "m", "same": "1", "height": "m", "force": "N"},
        status,
        tuple(errors),
    )


def test_the_page_holds_every_run_and_loads_nothing() -> None:
    text = page(results())
    assert not re.search(r"(src|href)\s*=|https?://(?!www.w3.org/2000/svg)", text)
    assert "diverged &lt;b&gt;here&lt;/b&gt;" in text
    assert "30 runs</b> of tripod: 28 done, 2 diverged" in text
    data = json.loads(text.partition('type="application/json">')[2].partition("</script>")[0])
    assert data["runs"] == list(range(2, 30))
    assert [each["name"] for each in data["variables"]] == ["soft", "wide"]  # what does not vary is no axis
    assert [each["name"] for each in data["quantities"]] == ["height", "force"]


def test_a_page_needs_a_run_that_is_done() -> None:
    with pytest.raises(StudyError, match="no run is done"):
        page(results(3, 3))


def test_a_quadratic_surface_is_found_exactly() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform([1.0, -5.0], [3.0, 100.0], (40, 2))

    def height(at: np.ndarray) -> np.ndarray:
        return 2.0 - at[:, 0] + 0.5 * at[:, 1] * at[:, 0] + 0.01 * at[:, 1] ** 2

    surface = response_surface(points, height(points))
    others = rng.uniform([1.0, -5.0], [3.0, 100.0], (10, 2))
    assert surface(others) == pytest.approx(height(others), rel=1e-9)
    assert surface.share == pytest.approx(1.0)


@pytest.mark.parametrize(("count", "terms"), [(1, 1), (3, 3), (5, 3), (6, 6)])
def test_of_few_runs_a_flatter_surface_is_fitted(count: int, terms: int) -> None:
    points = np.random.default_rng(1).random((count, 2)) if count > 1 else np.zeros((1, 0))
    assert len(response_surface(points, np.arange(float(count))).terms) == terms


def test_two_levels_of_a_variable_tell_no_square_of_it() -> None:
    points = np.array([[x, y] for x in (0.0, 1.0) for y in (0.0, 0.5, 1.0)])
    assert (0, 0) not in response_surface(points, points.sum(axis=1)).terms


@pytest.mark.slow
def test_a_browser_draws_it_without_an_error(tmp_path: Path) -> None:
    chromium = chromium_path()
    from playwright.sync_api import sync_playwright

    write_page(tmp_path / "p.html", page(results()))
    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        view = browser.new_page()
        told: list[str] = []
        view.on("pageerror", lambda error: told.append(str(error)))
        view.goto((tmp_path / "p.html").as_uri())
        assert view.locator("#lines polyline").count() == 28
        assert view.locator("#effects svg").count() == 2
        view.locator("#quantities button").nth(1).click()
        assert "it explains 100.0 %" in view.locator("#fit").inner_text()
        box = view.locator("#lines").bounding_box()
        assert box is not None
        scale = box["width"] / 1200.0
        view.mouse.move(box["x"] + 70 * scale, box["y"] + 40 * scale)  # the upper half of the first axis
        view.mouse.down()
        view.mouse.move(box["x"] + 70 * scale, box["y"] + 165 * scale)
        view.mouse.up()
        kept = view.locator("#lines polyline:not([stroke='#ddd'])").count()
        assert 0 < kept < 28
        browser.close()
    assert told == []


def test_the_progress_line_fills_with_the_runs_that_are_done(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = SimpleNamespace(monotonic=lambda: clock.now, now=0.0)
    for module in (sweep, command):
        monkeypatch.setattr(module, "time", clock)
    progress = sweep.Progress()
    for clock.now, done in ((1.0, 0), (61.0, 4)):  # a log has a line each minute
        progress(done, done // 4, 8)
    assert (
        f"[{10 * '#'}{10 * '.'}] 4/8 runs, 1 failed, 0.1 per second, 1 min 0 s to go"
        in capfd.readouterr().err
    )
