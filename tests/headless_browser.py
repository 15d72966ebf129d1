"""The system's Chromium without a screen: where it is, how it starts, and what spares it the pictures."""

from __future__ import annotations

import importlib.util
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

ARGUMENTS = (
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-dev-shm-usage",
)
"""WebGL in software."""

NOTHING_IS_DRAWN = """
for (const call of ['drawElements', 'drawArrays', 'drawElementsInstanced', 'drawArraysInstanced', 'clear']) {
    const draw = WebGL2RenderingContext.prototype[call];
    WebGL2RenderingContext.prototype[call] = function (...given) {
        if (window.picturesAreDrawn) draw.apply(this, given);
    };
}
"""
"""A picture costs a software renderer half a second; nodes, controls and messages are there without it.

A page draws all the same once its `picturesAreDrawn` is true.
"""


def chromium_path() -> str:
    """Path of Chromium; a skip without it, or a failure with REQUIRE_CHROMIUM=1."""
    reason = "" if importlib.util.find_spec("playwright") else "playwright is not installed"
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    reason = reason or ("" if found else "no Chromium: apt-get install chromium")
    if reason and os.environ.get("REQUIRE_CHROMIUM"):
        pytest.fail(reason)
    if reason:
        pytest.skip(reason)
    return str(found)


@contextmanager
def running_chromium() -> Iterator[Any]:
    """Run a headless Chromium with WebGL in software.

    While it runs, asyncio counts the loop of Playwright as running in this thread: `asyncio.run` is refused.
    """
    path = chromium_path()
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, headless=True, args=list(ARGUMENTS))
        yield browser
        browser.close()
