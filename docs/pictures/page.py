"""Write pictures of the page into docs/images: robots in a headless Chromium, moved by its own controls.

From the checkout: `.softsim/venv/bin/python docs/pictures/page.py`; needs Chromium and Playwright.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

from softsim_core.base import python_command, run_process, start_process

ROOT = Path(__file__).resolve().parents[2]
IMAGES = ROOT / "docs" / "images"
SOFTWARE_GL = [
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
]
WIDE, PHONE = (1400, 850), (390, 844)
WARNING = "Software WebGL rendering detected"


def press(page: Any, words: str) -> None:
    """Press a button."""
    page.get_by_role("button", name=words, exact=True).click()


def type_in(page: Any, slider: str, value: float) -> None:
    """Type a number into the field of a slider."""
    words = page.locator("label").get_by_text(slider, exact=True)
    field = words.locator("xpath=../../..").locator("input[type=text]")
    field.fill(f"{value:g}")
    field.press("Enter")


def mid_pose(page: Any) -> None:
    """Take the Tripod to its start, then up."""
    press(page, "A start pose")
    page.wait_for_timeout(9000)
    press(page, "Q mid pose")


def grasp(page: Any) -> None:
    """Let the gripper take the cube and lift it."""
    pulled = [(f"finger_{number}_cable", 0.012) for number in (1, 2, 3)]
    for slider, value in [("vertical", -0.05), *pulled, ("vertical", -0.02)]:
        type_in(page, slider, value)
        page.wait_for_timeout(4000)


def bend(page: Any) -> None:
    """Blow the finger up."""
    press(page, "Q bent pose")


def choose(page: Any, label: str, option: str) -> None:
    """Choose from a list that opens."""
    field = (
        page.locator("label").get_by_text(label, exact=True).locator("xpath=../../..").get_by_role("combobox")
    )
    field.click()
    field.fill(option)
    page.get_by_role("option", name=option, exact=True).click()


MOVES: dict[str, Callable[[Any], None]] = {"tripod": mid_pose, "cable_gripper": grasp, "pneu_finger": bend}


def window(size: tuple[int, int]) -> dict[str, int]:
    """Width and height by name."""
    return {"width": size[0], "height": size[1]}


@contextmanager
def open_page(browser: Any, robot: str, port: int) -> Iterator[Any]:
    """Start a robot with its page, and open that in a wide window."""
    words = ["up", robot, "--headless", "--no-bridge", "--port", str(port)]
    command = python_command("softsim_ros.cli", *words)
    with start_process(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=ROOT) as up:
        try:
            assert up.stdout is not None
            address = next(
                found[0] for line in up.stdout if (found := re.findall(r"open (http://\S+)", line))
            )
            page = browser.new_page(viewport=window(WIDE))
            page.set_default_timeout(90_000)
            page.goto(address)
            page.get_by_text("running").first.wait_for(state="visible")
            if page.get_by_text(WARNING).count():
                page.locator(".mantine-Notification-closeButton").first.click()
            yield page
            page.close()
        finally:
            up.terminate()


def take(browser: Any, robot: str, port: int) -> None:
    """Move a robot, and write what a wide window and a phone see."""
    with open_page(browser, robot, port) as page:
        MOVES[robot](page)
        page.wait_for_timeout(15_000)
        page.screenshot(path=IMAGES / f"viewer_{robot}.png")
        page.get_by_role("tab", name="View", exact=True).click()
        page.get_by_role("checkbox", name="Stress colours", exact=True).click()
        page.wait_for_timeout(5000)
        page.screenshot(path=IMAGES / f"viewer_{robot}_stress.png")
        page.set_viewport_size(window(PHONE))
        page.get_by_role("tab", name="Drive", exact=True).click()
        page.wait_for_timeout(5000)
        page.screenshot(path=IMAGES / f"viewer_{robot}_phone.png")


def take_own_robot(browser: Any, port: int) -> None:
    """Make a robot of a part; write how its cable pulls it, and how its tip is edited."""
    part = ROOT / "configs" / "parts" / "fin_ray_finger.stl"
    with tempfile.TemporaryDirectory() as folder:
        new = python_command("softsim_ros.cli", "new", "my_finger", "--from", part)
        run_process(new, check=True, stdout=subprocess.DEVNULL, cwd=folder)
        with open_page(browser, f"{folder}/my_finger/my_finger.yaml", port) as page:
            press(page, "Q moved pose")
            page.wait_for_timeout(15_000)
            page.screenshot(path=IMAGES / "own_robot.png")
            page.get_by_role("tab", name="Edit", exact=True).click()
            page.get_by_role("checkbox", name="Edit", exact=True).click()
            page.wait_for_timeout(5000)
            choose(page, "Chosen part", "attachments/tip")
            page.wait_for_timeout(5000)
            page.screenshot(path=IMAGES / "viewer_edit.png")


if __name__ == "__main__":
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    with sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=chromium, headless=True, args=SOFTWARE_GL)
        for number, name in enumerate(sys.argv[1:] or [*MOVES, "own_robot"]):
            if name == "own_robot":
                take_own_robot(running, 8090 + number)
            else:
                take(running, name, 8090 + number)
