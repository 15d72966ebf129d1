"""`softsim demo grasp`: the whole grasp, from commands on topics to what the topics tell."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.slow]

from softsim_core.scene.io import config_file  # noqa: E402
from softsim_ros.cli import run_command as main  # noqa: E402

DEMO = ("demo", "grasp", "--speed", "0")


def test_the_cube_is_lifted_held_and_put_down(ros_domain: int, capfd: pytest.CaptureFixture[str]) -> None:
    code, shown = main([*DEMO, "--check"]), "".join(capfd.readouterr())
    assert code == 0, shown
    lifted = float(re.search(r"lifted ([\d.]+) mm", shown)[1])
    held, slipped = map(float, re.search(r"held ([\d.]+) s, slipped ([\d.]+) mm", shown).groups())
    assert lifted >= 20.0
    assert held >= 5.0
    assert slipped <= 2.0


@pytest.mark.parametrize(
    ("changed", "passes"),
    [
        ({}, True),
        ({"lift": 0.019}, False),
        ({"slip": 0.0021}, False),
        ({"hold_time": 4.0}, False),
        ({"returned": 0.01}, False),
        ({"slip": float("nan")}, False),
    ],
)
def test_what_counts_as_a_grasp(changed: dict[str, float], passes: bool) -> None:
    from softsim_ros.cli.demos import GraspResult

    good = GraspResult(lift=0.03, slip=0.001, hold_time=5.5, returned=0.001, tension=2.0)
    assert replace(good, **changed).passed is passes


@pytest.mark.exhaustive
def test_without_friction_the_check_misses(
    ros_domain: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    slippery = tmp_path / "slippery.yaml"
    robot = config_file("robots/cable_gripper.yaml")
    slippery.write_text(f"extends: {robot}\nname: slippery\ncontact: {{friction: 0.0}}\n")
    assert main([*DEMO, "--check", "--robot", str(slippery)]) == 1
    assert "missed its marks" in capfd.readouterr().out
