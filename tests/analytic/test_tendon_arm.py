"""Arms pulled by tendons: their generator, the bending of their segments, goals with bounded tensions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tendon_goals import HIGHEST, LOWEST, SEGMENTS, random_goals

from softsim_core import ConfigError, InverseController, Simulation, load_scene
from softsim_core.base import FieldError, SceneError
from softsim_core.control.inverse import effector
from softsim_core.physics.actuation.cable import CableView
from softsim_core.physics.mechanics import rotation_log, rotation_of
from softsim_core.robots import bend_keys, bending_commands
from softsim_core.scene import Backbone, RobotDescription, Scene, Tendon, TendonSegment, tendon_arm

BACKBONE = Backbone(diameter=0.0012, young_modulus=60.0e9, density=6450.0)
MANY = "segments: [{length: 1.0, disks: 1000000000}]"
COUNTS = [3, pytest.param(200, marks=pytest.mark.exhaustive)]


def described(*given: Any, gravity: float = 0.0, **options: Any) -> RobotDescription:
    scene = Scene(gravity=(0.0, 0.0, -gravity))
    scene.add(tendon_arm(*given, **options))
    return scene.describe()


def turns(simulation: Simulation) -> np.ndarray:
    """Rotation vectors of the ends of all segments, (k, 3)."""
    rotations = [rotation_of(pose.quaternion_xyzw) for pose in simulation.frames().values()]
    return np.array([rotation_log(each) for each in rotations])


@pytest.mark.parametrize("lengths", [(0.08, 0.08, 0.08), (0.06, 0.0625, 0.064)])
def test_a_segment_bends_alone_to_its_angle(lengths: tuple[float, ...]) -> None:
    segments = [replace(each, length=length) for each, length in zip(SEGMENTS, lengths, strict=True)]
    tight = Tendon(compliance=1.0e-7, pretension=5.0)
    for k, bend in enumerate([(0.6, 0.0), (0.0, -0.5), (0.3, 0.4)]):
        bends = np.zeros((3, 2))
        bends[k] = bend
        simulation = Simulation(described(segments, BACKBONE, tight, down=False))
        simulation.settle(bending_commands(segments, bends))
        expected = np.cumsum(bends, axis=0) @ [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]  # towards x: about y
        np.testing.assert_allclose(turns(simulation), expected, atol=0.04)


def test_segments_differ_in_radius_stiffness_slack_and_tendons() -> None:
    """One tendon bends a segment by stroke / radius, and two segments inversely to their stiffness."""
    tight, loose = Tendon(compliance=1.0e-7), Tendon(compliance=1.0e-3)
    first = TendonSegment(0.08, (0.0,), disks=8, radius=0.004)
    second = TendonSegment(0.08, (0.0,), disks=8, radius=0.008, stiffness=2.0, slack=(0.001,))
    simulation = Simulation(described([first], BACKBONE, tight, down=False))
    simulation.settle([0.002])
    assert np.linalg.norm(turns(simulation)[-1]) == pytest.approx(0.5, rel=0.02)
    both = [replace(first, angles_deg=(), radius=0.006), replace(second, radius=0.006)]
    simulation = Simulation(described(both, BACKBONE, tight, down=False))
    simulation.settle([0.001])  # as long as the slack
    assert simulation.joint_efforts == pytest.approx([0.0], abs=1e-3)
    simulation.settle([0.004])
    bent = np.linalg.norm(turns(simulation), axis=1)[-2:]
    assert bent == pytest.approx([2.0 / 3.0 * 0.5, 0.5], rel=0.02)
    simulation = Simulation(described([replace(first, tendon=loose)], BACKBONE, tight, down=False))
    simulation.settle([0.002])
    stretch = 0.002 - 0.004 * np.linalg.norm(turns(simulation)[-1])
    assert stretch == pytest.approx(1.0e-3 * simulation.joint_efforts[0], rel=0.03)


def test_a_scene_file_describes_the_same_arm(tmp_path: Path) -> None:
    """The key `tendon_arm` gives what the function gives; other keys merge over it."""
    file = tmp_path / "mine.yaml"
    file.write_text(
        "name: mine\ngravity: [0, 0, 0]\njoints: [{name: s0t1, limits: {lower: -0.004, upper: 0.004}}]\n"
        "tendon_arm:\n  backbone: {diameter: 0.0012, young_modulus: 6.0e+10, density: 6450}\n"
        "  segments: [{length: 0.08, angles_deg: [0, 120, 240]}]\n"
    )
    robot = load_scene(file)
    made = described([SEGMENTS[0]], BACKBONE)
    assert robot.scene.bodies == made.scene.bodies
    assert robot.scene.attachments == made.scene.attachments
    assert robot.joints[0] == made.joints[0]
    assert robot.joints[1].limits.upper == 0.004
    for text, where in (
        ("segments: []", "at least one segment"),
        ("segments: [{length: -1}]", "length"),
        (MANY, "1 to 1000"),
        (
            "segments: [{length: 0.1}, {length: 0.1, slack: [0, -0.3, 0]}]",
            r"segments\[1\]: slack .*above -0.2 m",
        ),
    ):
        wrong = file.read_text().split("  segments")[0] + f"  {text}\n"
        (tmp_path / "wrong.yaml").write_text(wrong)
        with pytest.raises(ConfigError, match=rf"wrong.yaml: line \d+.*: tendon_arm.*{where}"):
            load_scene(tmp_path / "wrong.yaml")


def test_the_backbone_may_be_a_tube_that_hangs_or_stands() -> None:
    tube = replace(BACKBONE, diameter=0.002, wall=0.0004)
    for down in (True, False):
        robot = described(SEGMENTS, tube, down=down, gravity=9.81, disk_mass=0.001, tip_load=0.01)
        (body,) = robot.scene.bodies
        assert body.rod is not None
        assert body.rod.section.wall == 0.0004
        simulation = Simulation(robot)
        assert simulation.effector_pose is not None
        assert simulation.effector_pose.position[2] == pytest.approx(-0.24 if down else 0.24)
        assert simulation.model.mass.sum() == pytest.approx(
            0.025 + 6450.0 * np.pi * (0.001**2 - 0.0006**2) * 0.24, rel=1e-3
        )
    assert robot.joint_names == tuple(f"s{k}t{t}" for k in range(3) for t in range(3))
    assert robot.scene.effector == "arm_2"


def test_mistakes_are_refused() -> None:
    with pytest.raises(SceneError, match="at least one segment"):
        tendon_arm((), BACKBONE)
    with pytest.raises(FieldError, match="disk_mass"):
        tendon_arm(SEGMENTS, BACKBONE, disk_mass=-1.0)
    for wrong in ({"length": 0.0}, {"length": 0.1, "disks": 0}, {"length": 0.1, "angles_deg": (np.nan,)}):
        with pytest.raises(FieldError, match="segment"):
            TendonSegment(**wrong)


def test_a_key_bends_one_segment_and_the_tendons_of_later_ones_follow() -> None:
    keys = bend_keys(SEGMENTS, step=0.1)
    assert len(keys) == 12
    bends = np.array([[0.0, 0.0], [0.0, -0.1], [0.0, 0.0]])
    assert keys["l"].by == pytest.approx(bending_commands(SEGMENTS, bends))
    assert keys["l"].help == "segment 1 to -y"
    assert not any(keys["l"].by[:3])  # type: ignore[index]
    with pytest.raises(SceneError, match="by has 2 numbers for 9 joints"):
        replace(keys["l"], by=(0.1, 0.2))


@pytest.mark.slow
@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("more", [0.0, 1.5])
def test_goals_are_reached_with_tensions_within_their_bounds(count: int, more: float) -> None:
    """Commands go from control to a simulated arm, without feedback, as between the product's nodes."""
    robot = load_scene("tendon_arm", kind="robots")
    assert robot.inverse.torque_limit == 32.0
    settings = replace(robot.inverse, min_tension=robot.inverse.min_tension + more)
    controller, arm = InverseController(robot, settings), Simulation(robot)
    controller.start()
    arm.settle(controller.command)
    distances, lowest, highest = [], np.inf, -np.inf
    for goal in random_goals(robot, count):
        controller.set_goal(goal)
        for _ in range(2000):
            report = controller.tick()
            arm.command(report.command)
            arm.step()
            for tensions in (controller.model.joint_efforts, arm.joint_efforts):
                lowest, highest = min(lowest, tensions.min()), max(highest, tensions.max())
            distance = np.linalg.norm(effector(arm).position - goal.position)
            if report.status == "reached" and distance <= 0.5e-3:
                break
        distances.append(distance)
        print(f"{len(distances)} goals, worst {1e3 * max(distances):.3f} mm, {lowest:.3f} to {highest:.3f} N")
    assert max(distances) <= 0.5e-3
    assert lowest >= LOWEST + more
    assert highest <= HIGHEST


@pytest.mark.slow
@pytest.mark.parametrize("retry", [False, True])
def test_an_arm_that_has_curled_up_tries_once_more_from_its_posture(retry: bool) -> None:
    """The straight way of the tip from the straight arm to the goal ends 190 mm before it."""
    robot = load_scene("tendon_arm", kind="robots")
    assert robot.inverse.retry
    goals = Simulation(robot.robot_alone())
    goals.settle(bending_commands(SEGMENTS, np.array([[0.9, 0.02]] * 3)))
    controller = InverseController(robot, replace(robot.inverse, retry=retry))
    controller.start()
    controller.set_goal(effector(goals))
    messages, lowest, highest = set(), np.inf, 0.0
    for _ in range(2000):
        report = controller.tick()
        tensions = controller.model.joint_efforts
        lowest, highest = min(lowest, tensions.min()), max(highest, tensions.max())
        messages.add(report.message[:10])
        if report.status in ("reached", "stalled", "unreachable"):
            break
    assert report.status == ("reached" if retry else "stalled")
    assert ("going back" in messages) == retry
    assert lowest >= LOWEST
    assert highest <= HIGHEST


@pytest.mark.slow
def test_a_goal_out_of_reach_is_tried_twice_and_another_one_begins_anew() -> None:
    robot = load_scene("tendon_arm", kind="robots")
    controller = InverseController(robot)
    controller.start()
    tip = effector(controller.model)
    for way in ([0.05, 0.0, -0.03], [0.0, 0.06, -0.03]):
        controller.set_goal(replace(tip, position=tip.position + way))
        trips, last = 0, ""
        for _ in range(3000):
            report = controller.tick()
            trips += report.message.startswith("going back") and not last.startswith("going back")
            last = report.message
            if report.status in ("stalled", "unreachable"):
                break
        assert report.status in ("stalled", "unreachable")
        assert trips == 1


MEASURED = {  # of each motor: travel of the tip in [mm/deg], its direction in [deg], and travel of disk 1
    3: (1.05, -175.0, 0.37),
    5: (1.00, 111.0, 0.38),
    1: (1.50, -47.0, 0.15),
    6: (1.79, 43.0, 0.11),
    2: (1.25, -107.0, 0.03),
    4: (1.25, 163.0, 0.04),
}
"""Source: trunk-stack of the Stanford ASL, regression of its recorded motion; about a vertical axis, y up."""


@pytest.mark.slow
def test_the_trunk_bends_as_measured() -> None:
    robot = load_scene("trunk", kind="robots")
    simulation = Simulation(robot)
    simulation.settle(np.zeros(6))
    rest = [pose.position for pose in simulation.frames().values()]
    assert [point[2] for point in rest] == pytest.approx([-0.106, -0.201, -0.316], abs=5e-4)
    assert robot.board is not None
    for joint, servo in enumerate(robot.board.bus_servos):
        tip, direction, disk = MEASURED[servo.id]
        command = np.zeros(6)
        command[joint] = np.radians(20.0) * servo.travel
        simulation.settle(command)
        first, *_, last = (
            pose.position - start for pose, start in zip(simulation.frames().values(), rest, strict=True)
        )
        assert np.hypot(*last[:2]) / 0.02 == pytest.approx(tip, rel=0.2)
        assert np.degrees(np.arctan2(-last[1], last[0])) == pytest.approx(direction, abs=10.0)
        assert np.hypot(*first[:2]) / 0.02 == pytest.approx(disk, abs=0.05)


def test_tendons_rub_where_they_are_given_friction() -> None:
    """On the way back the tip is elsewhere; the tension of a pulled tendon falls from base to tip."""
    rubbing = Tendon(compliance=1.0e-4, pretension=2.0, friction=0.1, friction_per_length=1.0)
    simulation = Simulation(described(SEGMENTS, BACKBONE, rubbing))
    places = []
    for bend in (0.3, 0.8, 0.3):
        simulation.settle(bending_commands(SEGMENTS, np.full((3, 2), [bend, 0.0])))
        assert simulation.effector_pose is not None
        places.append(simulation.effector_pose.position)
        if bend == 0.8:
            pulled = simulation.actuators[0]
            assert isinstance(pulled, CableView)
            assert (np.diff(pulled.tensions) < 0.0).all()
    assert np.linalg.norm(places[2] - places[0]) > 1e-3
