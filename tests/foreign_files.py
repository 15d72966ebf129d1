"""A folder that somebody sent, names that lead to its files, and a watch on what of it is opened or run."""

from __future__ import annotations

import os
import random
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from softsim_core.scene.io import config_file

XACRO = """<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">
<link name="${(lambda: 'ran')()}"/></robot>"""
FILES = {
    "nice.yaml": "name: nice\narm: {urdf: parts.xacro}\n",
    "plain.yaml": "name: plain\nbodies: []\n",
    "program.py": "def create_scene(scene): pass\ndef told(simulation): return 1.0\n",
    "parts.xacro": XACRO,
    "part.stl": "solid part\nendsolid part\n",
    "part.vtk": "# vtk DataFile Version 2.0\n",
    "points.yaml": "points: []\n",
    "part.xml": "<mujoco/>",
    "state.snapshot": "state",
}


class Watch:
    """Which files of a folder are opened, and what of them runs, while it looks."""

    def __init__(self) -> None:
        self.folder, self.seen = "", list[str]()
        sys.addaudithook(self._hook)

    def _hook(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.folder or event not in ("open", "exec"):
            return
        name = arguments[0].co_filename if event == "exec" else arguments[0]
        is_file = isinstance(name, str | os.PathLike) and not str(name).startswith("<")
        place = os.path.realpath(name) if is_file else ""
        if place.startswith(self.folder):
            self.seen.append(f"{event} {os.path.relpath(place, self.folder)}")

    @contextmanager
    def on(self, folder: Path) -> Iterator[list[str]]:
        """What is seen of a folder within the `with` block."""
        self.folder, self.seen = str(folder.resolve()), []
        try:
            yield self.seen
        finally:
            self.folder = ""


@pytest.fixture(scope="module")
def watch() -> Watch:
    return Watch()


@pytest.fixture
def bait(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that somebody sent, in which the process was started; links to its files beside it."""
    folder = tmp_path / "downloads"
    folder.mkdir()
    for name, text in FILES.items():
        (folder / name).write_text(text)
        (folder / f"link_{name}").symlink_to(folder / name)
    monkeypatch.chdir(folder)
    return folder


def references(folder: Path, seed: int, count: int) -> list[str]:
    """Names by which files of a folder may be meant, from anywhere."""
    choose = random.Random(seed)
    files = [*FILES, *(f"link_{name}" for name in FILES)]
    climbing = config_file("robots/tripod.yaml").parent
    found = []
    for _ in range(count):
        name = choose.choice(files)
        file = folder / name
        found.append(
            choose.choice(
                (
                    name,
                    f"./{name}",
                    Path(name).stem,
                    str(file),
                    f"file://{file}",
                    f"package://{folder.name}/{name}",
                    f"$(find {folder.name})/{name}",
                    os.path.relpath(file, climbing),
                    f"{climbing}/{os.path.relpath(file, climbing)}",
                    f"{folder}/../{folder.name}/./{name}",
                    f"~/{os.path.relpath(file, Path.home())}",
                    f"{name}\0",
                )
            )
        )
    return found
