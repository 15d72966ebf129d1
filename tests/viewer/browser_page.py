"""The viewer's page in a browser, through what a person sees and does."""

from __future__ import annotations

import re
import time
import warnings
from contextlib import suppress
from typing import Any

from headless_browser import NOTHING_IS_DRAWN

WAIT_MS = 120_000
"""Longest wait; the machine may be busy, or pause the browser."""

SENT = "() => new Promise(done => setTimeout(done, 60))"
"""viser sends one message of the panel per 50 ms, the newest; after 60 ms of the page's clock it is sent."""

DRAWN = "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
"""The page has taken what came before, and places nodes of the scene where they are now."""

FRAMES_COME = """limit => Promise.race([
    new Promise(done => requestAnimationFrame(() => done(true))),
    new Promise(done => setTimeout(() => done(false), limit)),
])"""
"""Whether the browser draws another frame of the page within so many milliseconds."""

STILL = 5
"""So many times in a row the same place, with pictures in between, is one where something stays."""

NODES = "window.__viserMutable.nodeRefFromName"

PROJECT = f"""([x, y, z]) => {{
    const camera = window.__viserMutable.camera, root = {NODES}[''];
    const point = camera.position.clone().set(x, y, z);
    root.localToWorld(point);
    point.project(camera);
    const frame = window.__viserMutable.canvas.getBoundingClientRect();
    return [frame.left + (point.x + 1) / 2 * frame.width, frame.top + (1 - point.y) / 2 * frame.height];
}}"""

VERTICES = f"""(name) => {{
    const found = [];
    const node = {NODES}[name];
    if (node) node.traverse(part => {{
        if (part.geometry && part.geometry.attributes.position)
            found.push(...part.geometry.attributes.position.array);
    }});
    return found;
}}"""


class BrowserPage:
    """One tab with the page; only one that `draws` fills its canvas."""

    def __init__(
        self, browser: Any, address: str, *, width: int = 1300, height: int = 640, draws: bool = False
    ) -> None:
        self.requests: list[str] = []
        self.errors: list[str] = []
        self.connection: list[str] = []  # when it was there and gone, and why
        self.address, self.awaited, self.chosen = address, "", ""
        self.context = browser.new_context(viewport={"width": width, "height": height})
        if not draws:
            self.context.add_init_script(NOTHING_IS_DRAWN)
        self._open()

    def _open(self) -> None:
        self.page = self.context.new_page()
        self.page.set_default_timeout(WAIT_MS)
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("console", lambda message: self._note(message.text))
        self.page.goto(self.address)

    def reopened(self) -> bool:
        """Open the page anew, at the tab chosen last, if Chromium draws no more frames; whether it did.

        On a busy machine it sometimes stops for good. Scripts run on, so it is not the page's doing, but the
        page takes messages of the scene only with a frame.
        """
        if self.page.evaluate(FRAMES_COME, WAIT_MS / 2):
            return False
        warnings.warn("Chromium has stopped drawing the page; it is opened anew", stacklevel=2)
        self.page.close()
        self._open()
        self.wait_for_node(self.awaited)
        if self.chosen:
            self.tab(self.chosen)
        return True

    def _note(self, line: str) -> None:
        if re.match("Connect|Disconnected", line):
            self.connection.append(f"{time.strftime('%H:%M:%S')} {line}")

    def wait_for_node(self, name: str) -> None:
        """Wait until a node of the 3-D scene is there."""
        self.awaited = name
        self.page.wait_for_function(f"window.__viserMutable?.nodeRefFromName?.['{name}']", timeout=WAIT_MS)

    def wait_until_gone(self, name: str) -> None:
        """Wait until a node of the 3-D scene is not there any more."""
        self.page.wait_for_function(f"!{NODES}['{name}']", timeout=WAIT_MS)

    def vertices(self, name: str) -> list[float]:
        """Coordinates of the vertices on the screen, in mm, one after the other."""
        return list(self.page.evaluate(VERTICES, name))

    def screen(self, point: tuple[float, float, float]) -> tuple[float, float]:
        """Where a point in mm is seen, in pixels."""
        x, y = self.page.evaluate(PROJECT, list(point))
        return float(x), float(y)

    def tab(self, name: str) -> None:
        """Choose a tab by the keyboard: the mouse would wait for pictures, with which a page may be late.

        A panel that is drawn anew between focus and key press takes the focus away; a person presses again.
        """
        from playwright.sync_api import TimeoutError as NotInTime

        tab = self.page.get_by_role("tab", name=name, exact=True)
        chosen = self.page.get_by_role("tab", name=name, exact=True, selected=True)
        for limit_ms in (WAIT_MS / 4, WAIT_MS):
            tab.press("Enter")
            with suppress(NotInTime):
                chosen.wait_for(timeout=limit_ms)
                self.chosen = name
                return
        focus = self.page.evaluate("document.activeElement?.outerHTML.slice(0, 200)")
        raise AssertionError(f"tab {name} is not chosen; focus: {focus}; connection: {self.connection}")

    def click(self, name: str) -> None:
        from playwright.sync_api import TimeoutError as NotInTime

        try:
            self.page.get_by_role("button", name=name, exact=True).click()
        except NotInTime:  # the mouse waits for two pictures, the keyboard for none
            self.reopened()
            self.page.get_by_role("button", name=name, exact=True).press("Enter")
        self.page.evaluate(SENT)

    def tick(self, name: str) -> None:
        self.page.get_by_role("checkbox", name=name, exact=True).click()
        self.page.evaluate(SENT)

    def number(self, label: str) -> Any:
        """The number field of a slider."""
        words = self.page.locator("label").get_by_text(label, exact=True)
        return words.locator("xpath=../../..").locator("input[type=text]")

    def choose(self, label: str, option: str) -> None:
        """Choose from a list that opens."""
        words = self.page.locator("label").get_by_text(label, exact=True)
        field = words.locator("xpath=../../..").get_by_role("combobox")
        field.click()
        field.fill(option)
        self.page.get_by_role("option", name=option, exact=True).click()
        self.page.evaluate(SENT)

    def set_number(self, label: str, value: float) -> None:
        """Type a number into the field of a slider."""
        field = self.number(label)
        field.fill(f"{value:g}")
        field.press("Enter")

    def press(self, keys: str) -> None:
        """Press keys over the 3-D view: where a person types a number, they belong to the number."""
        self.page.evaluate("document.activeElement.blur()")
        self.page.keyboard.press(keys)

    def await_frames(self) -> None:
        """Wait until the page has drawn what it knows now."""
        self.page.evaluate(DRAWN)

    def still(self, place: str) -> list[float]:
        """Coordinates that an expression gives in the page, once they do not change any more."""
        seen = [self.page.evaluate(place)]
        while len(seen) < STILL or any(each != seen[-1] for each in seen[-STILL:]):
            self.await_frames()
            seen.append(self.page.evaluate(place))
        return [float(each) for each in seen[-1]]

    def point_at(self, place: tuple[float, float]) -> None:
        """Move the mouse to a place, and let the page find what lies there."""
        self.await_frames()
        self.page.mouse.move(*place)
        self.await_frames()

    def drag(self, start: tuple[float, float], end: tuple[float, float], *, shift: bool = False) -> None:
        """Press the mouse at one point, move in small steps, and leave the button down."""
        mouse = self.page.mouse
        self.point_at(start)
        if shift:
            self.page.keyboard.down("Shift")
        mouse.down()
        for step in range(1, 11):
            share = step / 10.0
            mouse.move(*(a + share * (b - a) for a, b in zip(start, end, strict=True)))
            self.await_frames()

    def release(self, *, shift: bool = False) -> None:
        self.page.mouse.up()
        if shift:
            self.page.keyboard.up("Shift")

    def close(self) -> None:
        self.context.close()
