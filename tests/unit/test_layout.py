"""The layout of the product: modules per folder, modules in all, and the map in the documentation."""

from __future__ import annotations

import re
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGES = ("softsim_core", "softsim_node", "softsim_ros", "servo_bridge")

MOST_IN_A_FOLDER = 15
MOST_MODULES = 482
"""Both become smaller, but for a new kind or command: a module is a concept that a reader would look for."""


def modules(packages: tuple[str, ...] = PACKAGES) -> list[Path]:
    files = (file for package in packages for file in (REPOSITORY / package).rglob("*.py"))
    return sorted(file.relative_to(REPOSITORY) for file in files)


def folders() -> list[Path]:
    return sorted({file.parent for file in modules((*PACKAGES, "benchmarks"))})


def test_a_folder_has_few_modules() -> None:
    found = modules((*PACKAGES, "benchmarks"))
    for folder in folders():
        own = [file.stem for file in found if file.parent == folder and file.stem != "__init__"]
        assert len(own) <= MOST_IN_A_FOLDER, f"{folder}: {len(own)} modules"


def test_modules_do_not_become_more() -> None:
    assert len(modules()) <= MOST_MODULES


def test_every_folder_is_a_package_that_says_what_it_is() -> None:
    for folder in folders():
        text = (REPOSITORY / folder / "__init__.py").read_text(encoding="utf-8")
        assert text.startswith(('"""', 'r"""')), folder


def test_the_map_shows_every_folder_and_no_other() -> None:
    text = (REPOSITORY / "docs" / "architecture.md").read_text(encoding="utf-8")
    layers = text.split("## Layers of `softsim_core`")[1].split("\n## ")[0]
    around = text.split("## Folders around the core")[1].split("\n## ")[0]
    shown = set()
    for prefix, part in (("softsim_core/", layers), ("", around)):
        for folder, about in re.findall(r"^\| `([\w/]+)/` \| (.+) \|$", part, re.MULTILINE):
            below = [f"{prefix}{folder}/{name}" for name in re.findall(r"`(\w+)/`", about)]
            shown |= {f"{prefix}{folder}", *(name for name in below if (REPOSITORY / name).is_dir())}
    shown.remove("servo_bridge/firmware")  # no Python
    groups = {
        "softsim_core",
        "softsim_core/physics",
        "softsim_core/control",
        "softsim_core/lab",
        "servo_bridge",
    }
    assert shown | groups == {str(folder) for folder in folders()}
