"""`softsim demo grasp`: the whole grasp, from commands on topics to what the topics tell."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.slow]

REPOSITORY = Path(__file__).resolve().parents[2]


def run_demo(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "softsim_ros.cli", "demo", "grasp", "--speed", "0", *arguments],
        capture_output=True,
        text=True,
        timeout=900.0,
        check=False,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
    )


def test_the_cube_is_lifted_held_and_put_down(ros_domain: int) -> None:
    done = run_demo("--check")
    assert done.returncode == 0, done.stdout + done.stderr
    lifted = float(re.search(r"lifted ([\d.]+) mm", done.stdout)[1])
    held, slipped = map(float, re.search(r"held ([\d.]+) s, slipped ([\d.]+) mm", done.stdout).groups())
    assert lifted >= 20.0
    assert held >= 5.0
    assert slipped <= 2.0


@pytest.mark.parametrize(
    ("changed", "passes"),
    [
        ({}, True),
        ({"lift": 0.019}, False),
        ({"slip": 0.0021}, False),
        ({"held": 4.0}, False),
        ({"returned": 0.01}, False),
        ({"slip": float("nan")}, False),
    ],
)
def test_what_counts_as_a_grasp(changed: dict[str, float], passes: bool) -> None:
    from softsim_ros.cli.demos.grasp import GraspResult

    good = GraspResult(lift=0.03, slip=0.001, held=5.5, returned=0.001, tension=2.0)
    assert replace(good, **changed).passed is passes


@pytest.mark.exhaustive
def test_without_friction_the_check_misses(ros_domain: int, tmp_path: Path) -> None:
    slippery = tmp_path / "slippery.yaml"
    robot = REPOSITORY / "configs" / "robots" / "cable_gripper.yaml"
    slippery.write_text(f"extends: {robot}\nname: slippery\ncontact: {{friction: 0.0}}\n")
    done = run_demo("--check", "--robot", str(slippery))
    assert done.returncode == 1, done.stdout + done.stderr
    assert "missed its marks" in done.stdout
