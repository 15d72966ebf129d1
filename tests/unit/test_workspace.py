"""The workspace of a robot: symmetric for a symmetric robot, the same every time, refusals in a sentence."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

from softsim_core import load_scene
from softsim_core.base import SceneError, install_command
from softsim_core.control.inverse import Workspace, sample_workspace
from softsim_core.physics.mechanics import JointLimits
from softsim_ros.cli import main


@pytest.fixture(scope="module")
def tripod() -> Workspace:
    """Twelve equilibria of the Tripod in a box of joints about its start pose."""
    scene = load_scene("tripod")
    limits = JointLimits(lower=-1.5, upper=-0.8, speed=3.5)
    joints = tuple(dataclasses.replace(joint, limits=limits) for joint in scene.joints)
    told: list[tuple[int, int]] = []
    workspace = sample_workspace(
        scene.with_scene(joints=joints), 12, progress=lambda *each: told.append(each)
    )
    assert told == [(done, 12) for done in range(1, 13)]
    return workspace


@pytest.mark.slow
def test_it_looks_at_corners_and_between(tripod: Workspace) -> None:
    assert (len(tripod.joints), len(tripod.failed)) == (12, 0)
    assert np.isin(tripod.joints, [-1.5, -0.8]).all(axis=1).sum() == 6  # half of the samples
    assert (tripod.joints >= -1.5).all()
    assert (tripod.joints <= -0.8).all()
    assert tripod.base_shift == 0.035


@pytest.mark.slow
def test_what_it_says_of_the_tripod(tripod: Workspace) -> None:
    summary = tripod.summary()
    assert 1e-6 < summary["volume_m3"] < 50e-6
    (x_low, x_high), (z_low, z_high) = summary["x_m"], summary["z_m"]
    assert -0.03 < x_low < 0.0 < x_high < 0.03
    assert 0.02 < z_low < z_high < 0.06
    assert (tripod.gains[:, 0] < 0.05).all()  # the servo arm is 25 mm long
    assert 1.0 <= summary["condition_best"] <= summary["condition_median"] <= summary["condition_worst"]


def test_equal_joints_leave_the_tripod_level(tripod: Workspace) -> None:
    equal = np.ptp(tripod.joints, axis=1) == 0.0
    assert equal.any()
    assert np.abs(tripod.tilts[equal]).max() < 0.02
    assert np.abs(tripod.positions[equal, :2]).max() < 1e-3


def test_gains_are_the_derivative_of_the_position(tripod: Workspace) -> None:
    from softsim_core import Simulation

    at = int(np.argmin(tripod.conditions))
    simulation, columns, step = Simulation(load_scene("tripod")), [], 1e-3
    for joint in np.eye(3):
        ends = []
        for sign in (1.0, -1.0):
            simulation.settle(tripod.joints[at] + sign * step * joint, tripod.base_shift)
            ends.append(simulation.effector_pose.position)
        columns.append((ends[0] - ends[1]) / (2.0 * step))
    gains = np.linalg.svd(np.array(columns).T, compute_uv=False)
    assert tripod.gains[at] == pytest.approx(gains, rel=1e-3)


def test_flat_workspaces_have_no_volume(tripod: Workspace) -> None:
    flat = dataclasses.replace(tripod, positions=tripod.positions * [1.0, 1.0, 0.0])
    assert flat.volume == 0.0


def test_what_has_no_workspace_says_why() -> None:
    scene = load_scene("tripod")
    with pytest.raises(SceneError, match="4 samples or more, not 3"):
        sample_workspace(scene, 3)
    with pytest.raises(SceneError, match="needs joints and an effector"):
        sample_workspace(scene.with_scene(effector=None))
    free = dataclasses.replace(scene.joints[0], limits=JointLimits())
    with pytest.raises(SceneError, match="joints without limits: servo_0; give them"):
        sample_workspace(scene.with_scene(joints=(free, *scene.joints[1:])))


@pytest.mark.slow
def test_the_command_prints_json_and_draws(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = [] if importlib.util.find_spec("matplotlib") is None else ["--out", str(tmp_path / "w.png")]
    assert main(["workspace", "tripod", "--samples", "4", "--json", "--base-shift", "0.035", *picture]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["robot"] == "tripod"
    assert len(report["positions_m"]) == report["samples"] == 4 - report["failed"]
    assert not picture or (tmp_path / "w.png").stat().st_size > 10_000


@pytest.mark.slow
def test_the_command_prints_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["workspace", "tripod", "--samples", "4"]) == 0
    assert "reachable volume (convex hull)" in capsys.readouterr().out


def test_a_picture_needs_matplotlib(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert main(["workspace", "tripod", "--out", "w.png"]) == 1
    assert capsys.readouterr().err == (
        f"softsim workspace: --out needs matplotlib; {install_command('report')}\n"
    )
