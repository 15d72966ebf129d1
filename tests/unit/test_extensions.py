"""Patches that add a kind to a copy of the product: few files each, and the kind works in the copy."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import BUILD_S

REPOSITORY = Path(__file__).resolve().parents[2]
FOLDER = REPOSITORY / "tests" / "extensions"
MOST_FILES = {
    "actuator": 2,
    "element": 2,
    "key": 2,
    "material": 2,
    "quantity": 1,
    "robot": 1,
    "sensor": 2,
    "tab": 2,
    "topic": 1,
}
"""Files of the product that a kind may touch: its own, and the one that registers it."""


def test_every_patch_is_tried() -> None:
    assert {file.stem for file in FOLDER.glob("*.patch")} == set(MOST_FILES)


@pytest.mark.slow
@pytest.mark.parametrize("kind", MOST_FILES)
def test_a_kind_is_one_file_and_its_registration(kind: str, tmp_path: Path, ros_domain: int) -> None:
    pytest.importorskip("rclpy")
    if kind == "tab":
        pytest.importorskip("viser")
    if shutil.which("git") is None:
        pytest.skip("git is not installed: nothing applies a patch")
    patch = FOLDER / f"{kind}.patch"
    assert len(re.findall("^diff --git", patch.read_text(encoding="utf-8"), re.MULTILINE)) <= MOST_FILES[kind]
    for name in ("configs", "softsim_core", "softsim_node", "softsim_ros", "servo_bridge"):
        shutil.copytree(REPOSITORY / name, tmp_path / name)  # with the kernels that are compiled already
    subprocess.run(["git", "apply", patch], cwd=tmp_path, check=True, timeout=BUILD_S)
    done = subprocess.run(
        [sys.executable, "-W", "ignore", FOLDER / f"{kind}.py"],
        cwd=tmp_path,
        env={
            **os.environ,
            "PYTHONPATH": str(tmp_path),
            "PYTHONDONTWRITEBYTECODE": "1",
            "ROS_DOMAIN_ID": str(ros_domain),
        },
        capture_output=True,
        text=True,
        timeout=BUILD_S,
        check=False,
    )
    assert (done.returncode, done.stdout) == (0, "works\n"), done.stderr
