"""The inverse controller in simulated time: goals reached and not, limits, feedback, odd goals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from inverse_goals import COUNTS, LOWER, SHIFT, START, UPPER, goals

from softsim_core import Pose, Simulation, load_scene
from softsim_core.base import Array, CommandError
from softsim_core.control.inverse import InverseController, InverseReport, Sensitivity, effector, place
from softsim_core.scene import InverseSettings, MaterialDescription

STEP = 3.5 * 0.01
"""Speed limit of a servo in [rad] a tick."""


@pytest.fixture(scope="module")
def standing() -> tuple[InverseController, bytes]:
    """A controller of the Tripod at its start pose, and the snapshot of its model there."""
    controller = InverseController(load_scene("tripod", kind="robots"))
    controller.start(START, SHIFT)
    return controller, controller.model.snapshot()


@pytest.fixture
def controller(standing: tuple[InverseController, bytes]) -> InverseController:
    begin(*standing)
    return standing[0]


def begin(controller: InverseController, at_start: bytes) -> None:
    """Stand at the start pose without goal, as after start()."""
    controller.model.restore(at_start)
    controller._begin(controller.model.joint_targets)


def ahead(controller: InverseController, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Pose:
    """A goal that far from the effector in [m]."""
    pose = effector(controller.model)
    return Pose(pose.position + np.array([x, y, z]), pose.quaternion_xyzw)


def assert_kept(before: Array, report: InverseReport) -> None:
    """Limits hold exactly, speed to rounding."""
    assert ((report.command >= LOWER) & (report.command <= UPPER)).all()
    assert np.abs(report.command - before).max() <= STEP + 1e-15


@pytest.mark.slow
@pytest.mark.numba
@pytest.mark.parametrize("count", COUNTS)
def test_goals_within_half_a_second_from_the_start_pose(
    standing: tuple[InverseController, bytes], count: int
) -> None:
    """Goals whose joints are at most 1 rad from the start pose: 0.29 s of travel at the servos' speed."""
    pytest.importorskip("numba")
    controller = standing[0]
    for _, goal in goals(count, seed=3, reach=1.0):
        begin(*standing)
        controller.set_goal(goal)
        before = controller.command
        for _ in range(50):
            report = controller.tick()
            assert_kept(before, report)
            before = report.command
        assert report.residual_m <= 1e-4
        assert report.status == "reached"


@pytest.mark.slow
@pytest.mark.numba
def test_goals_with_the_qr_law() -> None:
    """Its sensitivities are those of `polar` at the same state; the model that is steered is `qr` itself."""
    pytest.importorskip("numba")
    scene = load_scene("tripod", kind="robots")
    scene = scene.with_scene(solver=replace(scene.scene.solver, rotation="qr"))
    controller = InverseController(scene)
    controller.start(START, SHIFT)
    at_start = controller.model.snapshot()
    for _, goal in goals(2, seed=3, reach=0.5):
        begin(controller, at_start)
        controller.set_goal(goal)
        for _ in range(200):
            report = controller.tick()
        assert report.residual_m <= 1e-4
        assert report.status == "reached"


@pytest.mark.slow
@pytest.mark.numba
@pytest.mark.parametrize("count", COUNTS)
def test_goals_out_of_reach_in_a_row(standing: tuple[InverseController, bytes], count: int) -> None:
    """Goal jumps from one to the next, 0.1 m to 10 m from the middle; each ends steady and says so."""
    pytest.importorskip("numba")
    begin(*standing)
    controller, rng = standing[0], np.random.default_rng(4)
    before = controller.command
    for distance in np.geomspace(0.1, 10.0, count):
        direction = rng.normal(size=3)
        place_of_goal = np.array([0.0, 0.0, 0.035]) + distance * direction / np.linalg.norm(direction)
        controller.set_goal(Pose(place_of_goal, np.array([0.0, 0.0, 0.0, 1.0])))
        steady = 0
        for _ in range(1000):  # seen: half of them steady after 2.5 s of simulated time, all after 7 s
            report = controller.tick()
            assert_kept(before, report)
            assert report.kkt_residual <= 1e-8
            moved, before = float(np.abs(report.command - before).max()), report.command
            steady = steady + 1 if moved < 1e-6 else 0
            if steady >= 20 and report.status == "unreachable":
                break
        assert steady >= 20
        away = 1e3 * np.linalg.norm(place_of_goal - report.model_pose.position)
        assert report.status in ("unreachable", "stalled")  # some keep swinging about a limit
        if report.status == "unreachable":
            assert not report.reachable
            said = f"{away:.0f}" if away >= 1000.0 else f"{away:.3g}"
            assert report.message.startswith(f"unreachable, {said} mm away")


def test_a_reachable_goal(controller: InverseController) -> None:
    controller.set_goal(ahead(controller, 0.002, -0.001, 0.006))
    seen = {controller.tick().status for _ in range(40)}
    report = controller.tick()
    assert seen == {"moving", "reached"}
    assert report.residual_m < 1e-6
    assert report.reachable
    assert report.message.startswith("at the goal, ")
    assert 0.0 < report.qp_ms < report.tick_ms


def test_starts_from_the_present_joints_and_ramps() -> None:
    controller = InverseController(load_scene("tripod", kind="robots"))
    joints = np.array([-1.2, -0.7, -1.4])
    controller.start(joints, SHIFT)
    report = controller.tick()
    assert (report.status, report.message) == ("idle", "no goal, holding")
    np.testing.assert_array_equal(report.command, joints)
    controller.set_goal(ahead(controller, z=0.02))
    report = controller.tick()
    assert "servo_0 speed" in report.active
    assert np.abs(report.command - joints).max() == pytest.approx(STEP, abs=1e-15)


@pytest.mark.slow
def test_joints_outside_their_interval_come_back_at_their_speed() -> None:
    controller = InverseController(load_scene("tripod", kind="robots"))
    controller.start([0.2, 0.0, -1.0], SHIFT)  # the upper limit is -0.0255
    controller.set_goal(ahead(controller))
    last = controller.command
    for _ in range(10):
        command = controller.tick().command
        assert np.abs(command - last).max() <= STEP + 1e-15
        last = command
    assert (last <= UPPER).all()


@pytest.mark.parametrize(
    ("position", "quaternion", "words"),
    [
        ((np.nan, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), "three finite numbers; the goal stays"),
        ((np.inf, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), "three finite numbers; the goal stays"),
        ((0.0, 0.0, 0.04), (0.0, 0.0, 0.0, 0.0), "expected a unit quaternion"),
        ((0.0, 0.0, 0.04), (0.0, np.nan, 0.0, 1.0), "expected a unit quaternion"),
    ],
)
def test_a_goal_that_is_no_pose_is_one_sentence(
    controller: InverseController,
    position: tuple[float, ...],
    quaternion: tuple[float, ...],
    words: str,
) -> None:
    controller.set_goal(ahead(controller, z=0.002))
    kept = controller.goal
    with pytest.raises(CommandError, match=words) as refused:
        controller.set_goal(Pose(np.array(position), np.array(quaternion)))
    assert "\n" not in str(refused.value)
    assert controller.goal is kept


def test_no_start_at_joints_that_are_no_numbers(controller: InverseController) -> None:
    before = controller.model.snapshot()
    for joints in ([0.0, 0.0], [0.0] * 4, [np.nan, 0.0, 0.0], [0.0, -np.inf, 0.0]):
        with pytest.raises(CommandError, match=r"refused: expected .*; nothing was moved"):
            controller.start(joints)
    with pytest.raises(CommandError, match="base_shift nan refused"):
        controller.start(START, np.nan)
    assert controller.model.snapshot() == before


def test_the_goal_may_jump_at_any_tick(controller: InverseController) -> None:
    rng, before = np.random.default_rng(5), controller.command
    for _ in range(300):
        if rng.random() < 0.3:
            position = rng.uniform([-0.05, -0.05, -0.02], [0.05, 0.05, 0.1])
            controller.set_goal(Pose(position, np.array([0.0, 0.0, 0.0, 1.0])))
        report = controller.tick()
        assert_kept(before, report)
        before = report.command


def test_when_the_goal_stops_the_command_is_held(controller: InverseController) -> None:
    controller.set_goal(ahead(controller, z=0.01))
    for _ in range(5):
        controller.tick()
    held = controller.command
    controller.set_goal(None)
    for _ in range(5):
        report = controller.tick()
        assert report.status == "idle"
        np.testing.assert_array_equal(report.command, held)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["orientation", "height_tilt", "pose"])
def test_other_tasks_settle_and_speak_in_their_units(kind: str) -> None:
    settings = InverseSettings(task=kind)  # type: ignore[arg-type]
    controller = InverseController(load_scene("tripod", kind="robots"), settings)
    controller.start(START, SHIFT)
    half = 0.05
    goal = ahead(controller, z=0.015)
    controller.set_goal(Pose(goal.position, np.array([np.sin(half), 0.0, 0.0, np.cos(half)])))
    before = controller.command
    for _ in range(150):
        report = controller.tick()
        moved, before = np.abs(report.command - before).max(), report.command
    assert moved < 1e-6
    assert " deg away" in report.message
    assert (" mm " in report.message) == (kind != "orientation")
    if kind == "height_tilt":
        assert report.status == "reached"
        assert report.residual_m < 1e-6
        assert report.residual_rad < 1e-5


@pytest.mark.parametrize("kind", ["singular", "not a number"])
def test_an_old_sensitivity_is_told_with_its_age(
    controller: InverseController, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    def none_exists(model: Simulation, settings: InverseSettings, loads: Array | None) -> Sensitivity:
        if kind == "singular":
            raise np.linalg.LinAlgError("a branch of equilibria")
        return Sensitivity(np.full((6, 3), np.nan), np.full((3, 3), np.nan))

    controller.set_goal(ahead(controller, z=0.004))
    assert controller.tick().sensitivity_age == 0
    with monkeypatch.context() as patched:
        patched.setattr("softsim_core.control.inverse.controller.sensitivity_of", none_exists)
        reports = [controller.tick() for _ in range(3)]
    assert [report.sensitivity_age for report in reports] == [1, 2, 3]
    assert reports[0].message.endswith("; the sensitivity is 1 tick old, as none exists at this pose")
    assert reports[2].message.endswith("; the sensitivity is 3 ticks old, as none exists at this pose")
    assert all(report.status in ("moving", "reached") for report in reports)
    fresh = controller.tick()
    assert fresh.sensitivity_age == 0
    assert "sensitivity" not in fresh.message
    controller.set_goal(None)
    assert controller.tick().sensitivity_age == 0


@pytest.mark.slow
def test_a_torque_limit_is_kept_and_named() -> None:
    scene = load_scene("tripod", kind="robots")
    free = InverseController(scene)
    held = InverseController(scene, InverseSettings(torque_limit=0.25))
    efforts = []
    for controller in (free, held):
        controller.start(START, SHIFT)
        controller.set_goal(ahead(controller, x=0.01))
        for _ in range(200):
            report = controller.tick()
        efforts.append(float(np.abs(controller.model.joint_efforts).max()))
    assert efforts[0] > 0.253
    assert efforts[1] == pytest.approx(0.25, abs=1e-5)
    assert report.status == "unreachable"
    assert any(name.endswith(" torque") for name in report.active)


@pytest.mark.slow
def test_a_torque_that_no_pose_near_allows_moves_towards_it_within_the_limits() -> None:
    controller = InverseController(load_scene("tripod", kind="robots"), InverseSettings(torque_limit=0.05))
    controller.start(START, SHIFT)
    controller.set_goal(ahead(controller))
    before, efforts = controller.command, [np.abs(controller.model.joint_efforts).max()]
    for _ in range(60):
        report = controller.tick()
        assert_kept(before, report)
        before = report.command
        efforts.append(np.abs(controller.model.joint_efforts).max())
    assert efforts[-1] < 0.06 < efforts[0]


@pytest.mark.slow
def test_the_sampled_back_end_reaches_a_goal() -> None:
    controller = InverseController(load_scene("tripod", kind="robots"), InverseSettings(backend="sampled"))
    controller.start(START, SHIFT)
    controller.set_goal(ahead(controller, z=0.001))
    for _ in range(30):
        report = controller.tick()
    assert report.residual_m < 1e-5


def plant(factor: float) -> Simulation:
    """The Tripod at its start pose with another Young modulus."""
    scene = load_scene("tripod", kind="robots")
    (silicone,) = scene.scene.bodies
    modulus = factor * silicone.material.young_modulus
    material = MaterialDescription(young_modulus=modulus, poisson_ratio=silicone.material.poisson_ratio)
    changed = replace(silicone, material=material, surface=None)
    simulation = Simulation(replace(scene.scene, bodies=(changed,)))
    simulation.enforce_limits = False
    return simulation


def run_against(controller: InverseController, robot: Simulation, offset: Array, ticks: int) -> InverseReport:
    """Control a robot whose servos stand `offset` [rad] from their commands."""
    place(robot, START + offset, SHIFT)
    controller.set_goal(ahead(controller, 0.003, -0.002, 0.008))
    for _ in range(ticks):
        report = controller.tick(robot.effector_pose)
        robot.command(report.command + offset)
        robot.step()
    return report


OFFSET = np.radians([3.0, -3.0, 3.0])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("modulus", "offset"), [(0.8, OFFSET), (1.2, OFFSET), (1.2, -OFFSET), (0.8, 0 * OFFSET)]
)
def test_feedback_brings_another_plant_to_the_goal(
    controller: InverseController, modulus: float, offset: Array
) -> None:
    robot = plant(modulus)
    report = run_against(controller, robot, offset, 200)
    goal = controller.goal
    assert goal is not None
    assert np.linalg.norm(effector(robot).position - goal.position) < 2e-4  # 0.2 mm
    assert report.status == "reached"


@pytest.mark.slow
def test_without_feedback_the_error_is_reported() -> None:
    controller = InverseController(load_scene("tripod", kind="robots"), InverseSettings(feedback_gain=0.0))
    controller.start(START, SHIFT)
    robot = plant(0.8)
    report = run_against(controller, robot, OFFSET, 100)
    goal = controller.goal
    assert goal is not None
    error = float(np.linalg.norm(effector(robot).position - goal.position))
    assert error > 5e-4
    assert report.residual_m == pytest.approx(error, rel=1e-3)
    assert report.mismatch_m == pytest.approx(error, rel=1e-2)  # the model itself is at the goal
    assert "off the measured pose" in report.message


@pytest.mark.slow
def test_a_plant_that_stopped_winds_nothing_up(controller: InverseController) -> None:
    stopped = effector(controller.model)
    controller.set_goal(ahead(controller, z=0.006))
    before = controller.command
    for _ in range(400):
        report = controller.tick(stopped)
        assert_kept(before, report)
        moved, before = np.abs(report.command - before).max(), report.command
    assert moved < 1e-6
    assert np.linalg.norm(controller.correction[:3]) <= controller.settings.max_correction + 1e-12
    assert report.residual_m == pytest.approx(0.006)
    for _ in range(150):  # it follows again
        report = controller.tick(report.model_pose)
    assert report.status == "reached"


def test_an_imu_corrects_the_orientation_alone(controller: InverseController) -> None:
    pose = effector(controller.model)
    tilted = np.array([np.sin(0.02), 0.0, 0.0, np.cos(0.02)])
    for _ in range(200):
        report = controller.tick(Pose(np.full(3, np.nan), tilted))
    assert report.mismatch_m == 0.0
    assert report.mismatch_rad == pytest.approx(0.04, rel=1e-6)
    np.testing.assert_allclose(controller.correction, [0, 0, 0, 0.04, 0, 0], rtol=0, atol=1e-4)
    np.testing.assert_allclose(effector(controller.model).position, pose.position, rtol=0, atol=1e-9)
