"""One run of a study beside the same run by hand, and runs that go wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from study_files import written

from softsim_core import Simulation, load_scene
from softsim_core.base import SoftSimError
from softsim_core.control.inverse import Workspace
from softsim_core.lab.study import DIVERGED, DONE, LATE, RAISED, prepare_study, run_once

EVERYTHING = [
    {"name": "tip", "of": "effector.position"},
    {"name": "moved", "of": "effector.displacement.z", "at": "min"},
    {"name": "tilt", "of": "effector.tilt"},
    {"name": "tension", "of": "joint.cable.effort", "at": "max"},
    {"name": "pulled", "of": "joint.cable.position", "at": "mean"},
    {"name": "far", "of": "body.finger.displacement"},
    {"name": "stress", "of": "body.finger.stress", "at": "max"},
    {"name": "course", "of": "frame.tip.position", "at": "series", "every": 0.02},
]


def test_a_run_measures_what_the_same_run_by_hand_shows(tmp_path: Path) -> None:
    command = [{"joints": {"cable": 0.002}}, {"time": 0.05, "joints": {"cable": "= g / 1000"}}]
    work = prepare_study(written(tmp_path, measure=EVERYTHING, command=command, duration=0.1)).work
    outcome = run_once(work, [5.0])
    assert (outcome.status, outcome.error) == (DONE, "")

    simulation = Simulation(load_scene("cable_finger", {"gravity": [0.0, 0.0, -5.0]}))
    rest, start = simulation.positions, simulation.effector_pose
    assert start is not None
    poses, efforts, pulled, stresses = [start.position], [0.0], [0.0], [simulation.von_mises().max()]
    simulation.command([0.002])
    for step in range(1, 11):
        simulation.step()
        pose = simulation.effector_pose
        assert pose is not None
        poses.append(pose.position)
        efforts.append(float(simulation.joint_efforts[0]))
        pulled.append(float(simulation.joint_positions[0]))
        stresses.append(simulation.von_mises().max())
        if step == 5:
            simulation.command([0.005])
    told = outcome.results
    assert np.array_equal(told["tip"], poses[-1])
    assert told["moved"] == min(pose[2] - start.position[2] for pose in poses)
    assert told["tension"] == max(efforts) > 0.0
    assert told["pulled"] == pytest.approx(np.mean(pulled), rel=1e-12)
    assert told["far"] == np.linalg.norm(simulation.positions - rest, axis=1).max()
    assert told["stress"] == max(stresses)
    assert np.array_equal(told["course"], poses[::2])
    assert told["tilt"].shape == (3,)


def test_a_run_without_a_duration_is_the_equilibrium(tmp_path: Path) -> None:
    command = [{"joints": {"cable": "= g / 1000"}}]
    work = prepare_study(written(tmp_path, duration=None, command=command)).work
    simulation = Simulation(load_scene("cable_finger", {"gravity": [0.0, 0.0, -4.0]}))
    pose = simulation.equilibrium([0.004]).state.frame_positions[0]
    assert np.allclose(run_once(work, [4.0]).results["tip"], pose, atol=1e-10)


def test_a_workspace_can_be_held_to_what_drives_can_hold() -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 2]], dtype=float)
    efforts = np.array([[0.1, -0.2], [0.2, 0.1], [0.0, 0.1], [-0.2, 0.0], [0.1, -0.9]])
    none = np.zeros((5, 0))
    found = Workspace(0.0, none, corners, none, none, none, efforts, none)
    assert found.volume == pytest.approx(2.0 / 6.0)
    assert found.volume_within(0.2) == pytest.approx(1.0 / 6.0)
    assert found.volume_within(0.1) == 0.0


def test_arguments_reach_a_python_scene(tmp_path: Path) -> None:
    (tmp_path / "scene.py").write_text(
        "from softsim_core.robots import servo\n"
        "def create_scene(scene, length=0.01):\n"
        "    scene.add(servo('arm'))\n"
        "    scene.gravity = (0.0, 0.0, -length)\n",
        encoding="utf-8",
    )
    changes: dict[str, Any] = {"scene": "scene.py", "overlay": None, "arguments": {"length": "= g"}}
    measure = [{"name": "told", "of": "joint.arm.position"}]
    work = prepare_study(written(tmp_path, measure=measure, **changes), [tmp_path]).work
    assert work.robot([0.25]).scene.gravity == (0.0, 0.0, -0.25)
    assert work.load_unchanged().scene.gravity == (0.0, 0.0, -0.01)


@pytest.mark.parametrize(
    ("case", "status", "told"),
    [
        (0.5, DONE, ""),
        (1.0, RAISED, "ValueError: one is refused"),
        (2.0, LATE, "exceeded its time limit of 0.5 s"),
        (1e9, DIVERGED, "diverged at step 1"),
    ],
)
def test_a_run_that_goes_wrong_says_how(tmp_path: Path, case: float, status: int, told: str) -> None:
    measure = [{"name": "told", "of": "python", "function": "functions.py:faulty"}]
    limit = 0.5 if status == LATE else 300.0
    work = prepare_study(written(tmp_path, measure=measure, time_limit=limit), [tmp_path]).work
    outcome = run_once(work, [case])
    assert outcome.status == status
    assert outcome.error.startswith(told)
    assert bool(outcome.results) == (status == DONE)


SLEEPS = """
import threading
from pathlib import Path

def asleep(simulation):
    try:
        threading.Event().wait()
    finally:
        Path(__file__).with_name("woken").touch()

def translates(simulation):
    try:
        while True:
            pass
    except SystemExit:
        raise ValueError("the file cannot be read") from None

def leaves(simulation):
    raise SystemExit("enough")
"""


@pytest.mark.slow
def test_a_run_that_sleeps_is_left_at_its_time_limit(tmp_path: Path) -> None:
    measure = [{"name": "told", "of": "python", "function": "sleeps.py:asleep"}]
    (tmp_path / "sleeps.py").write_text(SLEEPS)
    work = prepare_study(written(tmp_path, measure=measure, time_limit=0.2), [tmp_path]).work
    Simulation(work.load_unchanged()).step()
    outcome = run_once(work, [0.5])
    assert (outcome.status, outcome.error) == (LATE, "exceeded its time limit of 0.2 s")
    assert not (tmp_path / "woken").exists()


def test_a_run_that_turns_its_end_into_an_error_of_its_own_is_late(tmp_path: Path) -> None:
    measure = [{"name": "told", "of": "python", "function": "sleeps.py:translates"}]
    (tmp_path / "sleeps.py").write_text(SLEEPS)
    outcome = run_once(
        prepare_study(written(tmp_path, measure=measure, time_limit=0.5), [tmp_path]).work, [0.5]
    )
    assert (outcome.status, outcome.error) == (LATE, "exceeded its time limit of 0.5 s")


def test_a_function_that_leaves_the_process_is_a_run_that_raised(tmp_path: Path) -> None:
    measure = [{"name": "told", "of": "python", "function": "sleeps.py:leaves"}]
    (tmp_path / "sleeps.py").write_text(SLEEPS)
    outcome = run_once(prepare_study(written(tmp_path, measure=measure), [tmp_path]).work, [0.5])
    assert (outcome.status, outcome.error) == (RAISED, "SystemExit: enough")


@pytest.mark.parametrize(
    ("of", "told"),
    [
        ("effector", "unknown 'effector'; known: effector.position"),
        ("effector.position.w", "unknown"),
        ("body.thumb.stress", "has no body 'thumb'; known: finger"),
        ("body.finger.stress.x", "has no x"),
        ("joint.cables.effort", "has no joint 'cables'; known: cable"),
        ("sensor.touch", "has no sensor 'touch'; known: none"),
        ("contact.ground", "has no body 'ground'; known: finger"),
        ("rigid.ball.position", "has no rigid body 'ball'; known: none"),
    ],
)
def test_an_unknown_quantity_is_refused_before_any_run(tmp_path: Path, of: str, told: str) -> None:
    prepared = prepare_study(written(tmp_path, measure=[{"name": "tip", "of": of}]))
    with pytest.raises(SoftSimError) as refused:
        prepared.plan(5, 2, [1.0])
    assert told in str(refused.value)


def test_the_force_on_a_body_that_rests_is_its_weight(tmp_path: Path) -> None:
    measure = [
        {"name": "force", "of": "contact.force"},
        {"name": "ball", "of": "contact.ball"},
        {"name": "gap", "of": "contact.gap"},
        {"name": "place", "of": "rigid.ball.position"},
    ]
    scene = tmp_path / "ball.yaml"
    scene.write_text(
        "name: ball_on_floor\n"
        "dt: 0.005\n"
        "rigid_bodies:\n"
        "  - {name: floor, shape: {box: [1, 1, 0.1]}, pose: {translation: [0, 0, -0.05]}}\n"
        "  - {name: ball, shape: {sphere: 0.01}, mass: 0.1, pose: {translation: [0, 0, 0.0101]}}\n"
        "collisions: [{name: floor, body: floor}, {name: ball, body: ball}]\n",
        encoding="utf-8",
    )
    work = prepare_study(written(tmp_path, scene="ball.yaml", measure=measure, duration=0.5)).work
    told = run_once(work, [8.0])
    assert told.error == ""
    assert told.results["ball"] == pytest.approx([0.0, 0.0, 0.8], abs=1e-6)
    assert told.results["force"] == pytest.approx(0.8, rel=1e-6)
    assert told.results["place"][2] == pytest.approx(0.01, abs=2e-3)
