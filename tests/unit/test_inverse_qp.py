"""The quadratic program of a step: what is built, what is solved, what is refused."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

from softsim_core import Pose, load_scene
from softsim_core.base import Array, SceneError
from softsim_core.control.inverse import (
    QP,
    Constraint,
    Limits,
    Linearisation,
    PositionTask,
    Sensitivity,
    build,
    kkt_residual,
    need_daqp,
    solve,
    solve_taut,
    torque_rows,
)
from softsim_core.scene import InverseSettings

HERE = Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
SETTINGS = InverseSettings(effort_weight=0.0)


def limits(size: int = 3, torque: float = np.inf) -> Limits:
    return Limits(
        tuple(f"joint_{k}" for k in range(size)),
        np.full(size, -1.0),
        np.full(size, 1.0),
        np.full(size, 0.1),
        np.full(size, torque),
    )


def random_qp(rng: np.random.Generator) -> QP:
    size, rows = int(rng.integers(1, 6)), int(rng.integers(0, 5))
    root = rng.normal(size=(size, size))
    names = tuple(str(k) for k in range(size + rows))
    return QP(
        root @ root.T + 1e-3 * np.eye(size),
        rng.normal(size=size),
        rng.normal(size=(rows, size)),
        rng.uniform(0.0, 0.5, rows),
        -rng.uniform(0.0, 0.4, size),
        rng.uniform(0.0, 0.4, size),
        np.ones(size, bool),
        np.ones(size, bool),
        names,
    )


@pytest.mark.parametrize("seed", range(50))
def test_random_programs_meet_their_optimality_conditions(seed: int) -> None:
    rng = np.random.default_rng(seed)
    qp = random_qp(rng)
    solution = solve(qp)
    assert solution.status == "solved"
    assert solution.kkt_residual <= 1e-8
    assert ((solution.dq >= qp.lower) & (solution.dq <= qp.upper)).all()  # exactly
    assert (qp.G @ solution.dq <= qp.h + 1e-9).all()
    best = 0.5 * solution.dq @ qp.P @ solution.dq + qp.q @ solution.dq
    for _ in range(200):  # nothing allowed is better
        other = rng.uniform(qp.lower, qp.upper)
        if (qp.G @ other <= qp.h).all():
            assert 0.5 * other @ qp.P @ other + qp.q @ other >= best - 1e-12


def test_a_wrong_answer_has_a_large_residual() -> None:
    qp = random_qp(np.random.default_rng(1))
    assert kkt_residual(qp, np.zeros(len(qp.q)), np.zeros(len(qp.q) + len(qp.h))) > 1e-3


def at(J: Array, joints: Array) -> Linearisation:
    """A robot at rest with given derivatives (6, 3) of its effector."""
    return Linearisation(Sensitivity(J, np.eye(3)), HERE, joints, np.zeros(3))


def test_the_unconstrained_step_solves_the_task() -> None:
    J = np.random.default_rng(2).normal(size=(6, 3))
    task = PositionTask(J[:3] @ [0.01, -0.02, 0.03], np.ones(3))
    settings = replace(SETTINGS, max_shift=1.0)
    qp = build([task], at(J, np.zeros(3)), limits(), settings)
    np.testing.assert_allclose(solve(qp).dq, [0.01, -0.02, 0.03], atol=1e-9)


def test_limits_are_kept_exactly_and_named() -> None:
    J = np.vstack([np.eye(3), np.zeros((3, 3))])
    task = PositionTask(np.array([0.5, -0.5, 0.005]), np.ones(3))
    settings = replace(SETTINGS, max_shift=1.0)
    joints = np.array([0.97, 0.0, 0.0])
    solution = solve(build([task], at(J, joints), limits(), settings))
    assert solution.dq[0] == 1.0 - 0.97
    assert solution.dq[1] == -0.1
    assert solution.active == ("joint_0 upper", "joint_1 speed")


def test_joints_outside_their_interval_are_led_back() -> None:
    J = np.vstack([np.eye(3), np.zeros((3, 3))])
    joints = np.array([1.5, -1.05, 0.0])
    qp = build(
        [PositionTask(np.zeros(3), np.ones(3))],
        at(J, joints),
        limits(),
        SETTINGS,
    )
    np.testing.assert_allclose(solve(qp).dq, [-0.1, 0.05, 0.0], atol=1e-12)


def test_torque_rows_stop_at_the_limit_and_lead_back_over_it() -> None:
    T, held = np.diag([2.0, 1.0]), limits(2, 1.0)
    rows = torque_rows(T, np.array([0.9, -0.5]), held)
    assert rows.names == ("joint_0 torque", "joint_1 torque") * 2
    np.testing.assert_allclose(rows.h, [0.1, 1.5, 1.9, 0.5])
    over = torque_rows(T, np.array([3.0, 0.0]), held)  # 2 over: one step can do 0.1 * 2 and is asked for half
    np.testing.assert_allclose(over.h, [-0.1, 1.0, 4.0, 1.0])
    assert torque_rows(T, np.zeros(2), limits(2)).inactive


def test_what_cannot_be_is_infeasible_and_moves_nothing() -> None:
    J = np.vstack([np.eye(3), np.zeros((3, 3))])
    wall = Constraint(np.array([[1.0, 0.0, 0.0]]), np.array([-0.5]), ("wall",))  # dq_0 <= -0.5: too fast
    qp = build(
        [PositionTask(np.ones(3), np.ones(3))],
        at(J, np.zeros(3)),
        limits(),
        SETTINGS,
        constraints=[wall],
    )
    solution = solve(qp)
    assert solution.status == "infeasible"
    np.testing.assert_array_equal(solution.dq, np.zeros(3))
    crossed = qp._replace(lower=np.ones(3), upper=-np.ones(3))
    assert solve(crossed).status == "infeasible"


def test_further_rows_enter_and_are_named() -> None:
    J = np.vstack([np.eye(3), np.zeros((3, 3))])
    wall = Constraint(np.array([[1.0, 0.0, 0.0]]), np.array([0.002]), ("wall",))
    qp = build(
        [PositionTask(np.full(3, 0.009), np.ones(3))],
        at(J, np.zeros(3)),
        limits(),
        SETTINGS,
        constraints=[wall],
    )
    solution = solve(qp)
    np.testing.assert_allclose(solution.dq, [0.002, 0.009, 0.009], atol=1e-11)
    assert solution.active == ("wall",)


def test_numbers_that_are_none_are_a_result_not_an_error() -> None:
    qp = random_qp(np.random.default_rng(3))
    solution = solve(qp._replace(q=np.full_like(qp.q, np.nan)))
    assert solution.status == "not_converged"
    np.testing.assert_array_equal(solution.dq, np.zeros(len(qp.q)))


def test_redundant_joints_share_by_effort() -> None:
    """Two joints move one coordinate alike; the one that is twice as stiff takes a quarter of the other."""
    J = np.zeros((6, 2))
    J[0] = 1.0
    settings = InverseSettings(effort_weight=1e-6)
    task = PositionTask(np.array([0.005, 0.0, 0.0]), np.ones(3))
    sensitivity = Sensitivity(J, np.diag([2.0, 1.0]))
    qp = build([task], Linearisation(sensitivity, HERE, np.zeros(2), np.zeros(2)), limits(2), settings)
    np.testing.assert_allclose(solve(qp).dq, [0.001, 0.004], rtol=1e-4)


def test_the_settings_narrow_the_robot_s_limits() -> None:
    scene = load_scene("tripod", kind="robots").scene
    own = Limits.of(scene, InverseSettings(), 0.01)
    np.testing.assert_array_equal(own.lower, np.full(3, -2.0225))
    np.testing.assert_allclose(own.step, 0.035)
    narrow = Limits.of(scene, InverseSettings(lower=-1.0, upper=1.0, speed=1.0), 0.01)
    np.testing.assert_array_equal(narrow.lower, np.full(3, -1.0))
    np.testing.assert_array_equal(narrow.upper, np.full(3, -0.0255))
    np.testing.assert_allclose(narrow.step, 0.01)


def test_without_daqp_one_sentence_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "daqp", None)
    with pytest.raises(SceneError, match="needs the package daqp: pip install daqp"):
        need_daqp()


def test_increments_that_are_no_numbers_solve_nothing() -> None:
    """Largest of nothing and NaN is nothing, by the order in which max() compares."""
    qp = random_qp(np.random.default_rng(0))
    multipliers = np.zeros(len(qp.names))
    assert np.isnan(kkt_residual(qp, np.full(len(qp.q), np.nan), multipliers))
    assert np.isnan(kkt_residual(qp, np.zeros(len(qp.q)), np.full(len(qp.names), np.nan)))


def nearly_dependent_tendons(rng: np.random.Generator) -> tuple[QP, Array, Array]:
    """A program of tendons that only bend a body, or pull against each other; its T and tensions."""
    size = int(rng.integers(4, 21))
    turned, _ = np.linalg.qr(rng.normal(size=(size, size)))
    T = (turned * np.logspace(3.0, 9.0, size)) @ turned.T  # N/m
    J = rng.normal(size=(3, size)) @ np.linalg.inv(T) * 1e3
    tensions = 10.0 * np.maximum(rng.normal(size=size), 0.0)
    long = np.linalg.norm(T, axis=1)
    names = tuple(f"tendon_{k}" for k in range(size))
    step = np.full(size, 1e-3)
    qp = QP(
        J.T @ J + 1e-6 * np.eye(size), -1e-2 * rng.normal(size=3) @ J, -T / long[:, None], tensions / long,
        -step, step, np.zeros(size, bool), np.zeros(size, bool),
        (*names, *(f"{name} slack" for name in names)),
    )  # fmt: skip
    return qp, T, tensions


@pytest.mark.parametrize("seed", range(40))
def test_nearly_dependent_tendons_stay_taut_and_are_the_best_that_do(seed: int) -> None:
    rng = np.random.default_rng(seed)
    qp, T, tensions = nearly_dependent_tendons(rng)
    solution = solve_taut(qp)
    assert solution.status == "solved"
    assert ((solution.dq >= qp.lower) & (solution.dq <= qp.upper)).all()  # exactly
    assert (tensions + T @ solution.dq).min() > -1e-3  # N
    assert {name.split()[0] for name in solution.active} <= set(qp.names[: len(qp.q)])
    best = 0.5 * solution.dq @ qp.P @ solution.dq + qp.q @ solution.dq
    for _ in range(200):  # tensions that tendons can have, whose commands are within bounds
        other = np.linalg.solve(T, rng.choice([0.0, 1.0], len(T)) * rng.exponential(10.0, len(T)) - tensions)
        other *= min(1.0, 1e-3 / max(float(np.abs(other).max()), 1e-300))  # what lies between is taut, too
        assert 0.5 * other @ qp.P @ other + qp.q @ other > best - 1e-6 * abs(best)
