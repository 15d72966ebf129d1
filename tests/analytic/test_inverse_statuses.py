"""Inverse control says what it knows: goals that poses make exactly reachable, and goals far outside."""

from __future__ import annotations

import numpy as np
import pytest
from tendon_bar import LENGTH, tendon_bar

from softsim_core import InverseController, Pose, PositionTask, Simulation, solve_pose
from softsim_core.base import Array
from softsim_core.control.inverse import AdaptiveDamping, Pace, pace, slowest_period
from softsim_core.scene import InverseSettings

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
DTS = (0.005, 0.02)


def tip(tendons: int, *pulled: float) -> Array:
    """Where the tip rests with the first tendons pulled in that far in [m] and the others at 0, (3,)."""
    simulation = Simulation(tendon_bar(tendons, 0.02))
    simulation.settle([*pulled, *(tendons - len(pulled)) * [0.0]])
    pose = simulation.effector_pose
    assert pose is not None
    return pose.position.copy()


@pytest.mark.slow
@pytest.mark.parametrize("dt", DTS)
@pytest.mark.parametrize("tendons", [2, 4, pytest.param(8, marks=pytest.mark.exhaustive)])
def test_a_slow_bar_reaches_a_pose_of_its_own_at_any_dt(tendons: int, dt: float) -> None:
    goal = tip(tendons, 0.008, 0.004)
    controller = InverseController(tendon_bar(tendons, dt), InverseSettings())
    controller.start()
    controller.set_goal(Pose(goal, UPRIGHT))
    within = max(3.0, 2.0 * controller.slowest_period)
    seen = [controller.tick().status for _ in range(round(within / dt))]
    assert seen[-1] == "reached"
    assert "unreachable" not in seen


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_a_goal_outside_is_never_reached(seed: int) -> None:
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=3)
    goal = 1.5 * LENGTH * direction / np.linalg.norm(direction)
    controller = InverseController(tendon_bar(4, 0.02))
    controller.start()
    controller.set_goal(Pose(goal, UPRIGHT))
    assert "reached" not in {controller.tick().status for _ in range(150)}


FEW = (4, 12, 20)
"""Tendons of the searches in every run of the suite."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "tendons", [pytest.param(n, marks=() if n in FEW else pytest.mark.exhaustive) for n in range(4, 21)]
)
def test_the_static_search_finds_poses_of_parallel_tendons(tendons: int) -> None:
    rng = np.random.default_rng(tendons)
    pulled = np.zeros(tendons)
    pulled[rng.permutation(tendons)[:3]] = rng.uniform(0.0, 0.02, 3)
    for pull in ((0.008, 0.004), pulled):
        found = solve_pose(tendon_bar(tendons, 0.02), PositionTask(tip(tendons, *pull), np.ones(3)))
        assert found.status == "reached"
        assert found.residual_m < 1e-6


def test_a_search_that_runs_out_of_steps_gave_up() -> None:
    task = PositionTask(tip(2, 0.008, 0.004), np.ones(3))
    found = solve_pose(tendon_bar(2, 0.02), task, most_steps=1)
    assert (found.status, found.reachable) == ("gave_up", False)


@pytest.mark.slow
def test_a_goal_beyond_the_tip_is_unreachable() -> None:
    """No tendon makes the bar longer."""
    found = solve_pose(tendon_bar(2, 0.02), PositionTask(np.array([0.0, 0.0, 2 * LENGTH]), np.ones(3)))
    assert found.status == "unreachable"
    assert not found.reachable


@pytest.mark.slow
def test_tendons_that_start_outside_their_interval_are_led_back_into_it() -> None:
    controller = InverseController(tendon_bar(8, 0.02), InverseSettings(lower=0.002))
    controller.start()
    controller.set_goal(Pose(tip(8, 0.006, 0.003), UPRIGHT))
    statuses = {controller.tick().status for _ in range(20)}
    assert "infeasible" not in statuses
    assert controller.command.min() == 0.002


@pytest.mark.slow
def test_a_goal_is_not_reached_with_more_tension_than_allowed() -> None:
    """Sixteen tendons on two cells share tension as the mesh has it, which commands do not steer."""
    controller = InverseController(tendon_bar(16, 0.02), InverseSettings(torque_limit=2.0))
    controller.start()
    controller.set_goal(Pose(tip(16, 0.006, 0.003), UPRIGHT))
    for _ in range(100):
        report = controller.tick()
        overloaded = np.flatnonzero(controller.model.joint_efforts > 2.1)
        assert {f"tendon_{k} torque" for k in overloaded} <= set(report.active)
        assert report.status != "reached" or not len(overloaded)


@pytest.mark.slow
@pytest.mark.parametrize("tendons", [8, pytest.param(16, marks=pytest.mark.exhaustive)])
def test_weights_that_differ_do_not_make_a_goal_unreachable(tendons: int) -> None:
    settings = InverseSettings(position_weights=(1000.0, 1.0, 1.0))
    controller = InverseController(tendon_bar(tendons, 0.02), settings)
    controller.start()
    controller.set_goal(Pose(tip(tendons, 0.006, 0.003), UPRIGHT))
    statuses = [controller.tick().status for _ in range(150)]
    assert statuses[-1] == "reached"
    assert "unreachable" not in statuses


@pytest.mark.slow
def test_the_goal_may_move_while_control_is_on_its_way() -> None:
    controller = InverseController(tendon_bar(8, 0.02))
    controller.start()
    statuses = []
    for pulls in ((0.004, 0.008), (0.0, 0.002, 0.01), (0.006, 0.003)):
        controller.set_goal(Pose(tip(8, *pulls), UPRIGHT))
        statuses += [controller.tick().status for _ in range(8)]
    assert set(statuses) <= {"moving", "limited"}
    assert {controller.tick().status for _ in range(150)} <= {"moving", "limited", "reached"}
    assert controller.tick().status == "reached"


@pytest.mark.slow
def test_tendons_of_one_route_have_a_sensitivity() -> None:
    controller = InverseController(tendon_bar(3, 0.02, same=True))
    controller.start()
    controller.set_goal(Pose(tip(1, 0.004), UPRIGHT))
    statuses = {controller.tick().status for _ in range(150)}
    assert statuses <= {"moving", "limited", "reached"}


def ticks_without_progress(distances: Array) -> float:
    damping = AdaptiveDamping(1, 0.03)
    for distance in distances:
        damping.learn(np.zeros(1), float(distance), there=False, approach=0.2)
    return damping.stalled


def test_a_calm_approach_after_a_swing_past_the_goal_is_progress() -> None:
    calm = 1e-3 * np.exp(-0.1 * np.arange(60))
    calm[5] = 1e-9  # the moment at which it is past
    assert ticks_without_progress(calm) == 0.0


def test_a_swing_that_lasts_is_no_progress() -> None:
    swing = 1e-3 * np.abs(np.cos(np.pi / 10.0 * np.arange(200)))
    assert ticks_without_progress(swing) > 150.0


def test_the_slowest_period_is_that_of_a_cantilever() -> None:
    """Euler-Bernoulli: w = 1.875^2 sqrt(E I / (rho A L^4)); tetrahedra of this size are stiffer."""
    simulation = Simulation(tendon_bar(0, 0.02, layers=24))
    stiffness, mass_per_length = 4e5 * 0.04**4 / 12.0, 1100.0 * 0.04**2
    w = 1.8751**2 * np.sqrt(stiffness / (mass_per_length * LENGTH**4))
    hanging = np.sqrt(w**2 + 1.5 * 9.81 / LENGTH)  # gravity stiffens about as a pendulum
    assert slowest_period(simulation) == pytest.approx(2 * np.pi / hanging, rel=0.25)


@pytest.mark.parametrize("dt", [0.001, 0.002, 0.005, 0.01, 0.02, 0.05])
@pytest.mark.parametrize("damping", [0.0, 0.001, 0.01, 0.1])
def test_the_rate_is_stable_for_the_slowest_mode_and_all_faster_ones(dt: float, damping: float) -> None:
    """The largest pole of a tick around one mode of the model, stepped by implicit Euler."""
    for period in (0.005, 0.02, 0.1, 0.7, 2.0, 5.0):
        shares = pace(70.0, period, (0.0, damping + dt), dt)
        for faster in (1.0, 1.3, 2.0, 6.0, 30.0):
            poles = poles_of(shares, faster / period, damping, dt)
            assert poles.max() < 1.0
        if period >= 0.1 and damping < 0.1 * period:  # an error shrinks to a fifth within a period or so
            assert poles_of(shares, 1.0 / period, damping, dt).max() ** (1.5 * period / dt) < 0.2


def poles_of(shares: Pace, frequency: float, damping: float, dt: float) -> Array:
    """Sizes of the three poles of a tick."""
    return np.abs(np.linalg.eigvals(tick(shares.approach, shares.catch_up, frequency, damping, dt)))


def tick(approach: float, catch_up: float, frequency: float, damping: float, dt: float) -> Array:
    """One tick of (effector x, its velocity v, its resting place u), the goal being 0, shape (3, 3)."""
    w = 2.0 * np.pi * frequency
    x, v, u = np.eye(3)
    resting = u + catch_up * (x - u) - approach * x
    velocity = (v + dt * w**2 * (resting - x) + damping * w**2 * (resting - u)) / (
        1.0 + dt * (dt + damping) * w**2
    )
    return np.array([x + dt * velocity, velocity, resting])


def test_the_gain_of_a_tick_is_taken_for_a_release_with_a_warning() -> None:
    with pytest.warns(UserWarning, match="inverse.gain = 0.5 is deprecated"):
        old = InverseSettings(gain=0.5)
    assert old.rate_at(0.01) == pytest.approx(69.3147, rel=1e-5)
    assert 1.0 - np.exp(-old.rate_at(0.002) * 0.002) == pytest.approx(0.5)
    assert InverseSettings(rate=20.0).rate_at(0.01) == 20.0
