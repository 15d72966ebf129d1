"""Best joints for a goal in static equilibrium: a sequence of quadratic programs and equilibria.

    dq_k = argmin QP(e(x_k), J(x_k)),    q_k+1 = q_k + dq_k,    x_k+1 the equilibrium at q_k+1

A step that does not reduce the weighted error is undone, and the next one may be half as long. With compiled
steps the model moves to each equilibrium in simulated time, which is faster; the last equilibrium is solved
statically.

Source: Nocedal and Wright 2006, ch. 10 (Gauss-Newton, trust region).
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeAlias

import numpy as np

from softsim_core.base import Array, BoolArray, IndexArray, NotConvergedError, SolverDivergedError
from softsim_core.control.inverse.problem import (
    QP,
    Constraint,
    Limits,
    Linearisation,
    Solution,
    build,
    compute_step_error,
    scales,
    solve,
)
from softsim_core.control.inverse.sensitivity import Sensitivity, analytic_sensitivity, sampled_sensitivity
from softsim_core.control.inverse.tasks import Task
from softsim_core.physics.mechanics import Pose
from softsim_core.scene import InverseSettings, RobotDescription, SceneDescription, as_robot
from softsim_core.simulation import Simulation

MOST_STEPS = 30
"""Default limit of quadratic programs per search: ten are usual, several tendons need more."""

USELESS = 0.02
"""A whole step that would reduce the error by less than this part of it counts as useless."""

STEP_SHARE = 0.5
"""Part of a joint's interval that the first step may cross."""

FREE_STEP = 0.5
"""First step of a joint without interval.

This and the following lengths are in units of Limits.scale, 1 rad or 1 m.
"""

STILL = 1e-6
"""A step shorter than this ends the search."""

CERTAIN = 1e-4
"""A step shorter than this is not undone, because the change of the error is rounding."""

STRIDE = 0.05
"""Largest joint travel of a time step of a walk."""

SAMPLE = 1e-3
"""Distance of the sampled equilibria to both sides of a joint."""

SLIDE = 0.002
"""Travel in [m] of the bases in a time step of a walk."""

AT_REST = 1e-8
"""A walk ends when no node is faster than this, in [m/s]."""

LOOSE = 1e-6
"""Allowed slack in [m] of nearly dependent tendons, where no program can keep all of them taut."""

LEAST_TENSION = 1e-10
"""Weight of tensions in a program in tensions, as a part of its mean curvature.

It determines the tensions that the task leaves open.
"""

SLACK = " slack"
"""Suffix of the names of rows that keep a tendon taut."""

LONGEST_REST = 300
"""A walk also ends after this many time steps at its end."""


WIDE: Final = 1e3
"""Largest error in [m] and [rad]: a search limits the step, not its target."""

PoseStatus: TypeAlias = Literal["reached", "unreachable", "gave_up", "stalled", "infeasible", "not_converged"]


@dataclass(frozen=True, slots=True, eq=False)
class PoseSolution:
    """Joints for a goal.

    Attributes:
        joints: Commands in [rad] or [m], shape (j,), inside the limits.
        pose: Pose of the effector there, at rest.
        residual_m, residual_rad: Length of the error in [m] and in [rad] over the tasks' coordinates.
        iterations: Number of quadratic programs.
        reachable: Whether the residual is within the settings' tolerance; True only if this was verified.
        kkt_residual: Residual of the last program, in [rad] or [m].
        active: Names of the limits that constrain the last step.
        status: "reached" (within the settings' tolerance); "unreachable" (no step within the limits leads
            nearer); "gave_up" (the limit of programs was hit); "stalled" (a step is predicted to lead nearer,
            but none does); "infeasible" or "not_converged" (the last program, see Solution).
    """

    joints: Array
    pose: Pose
    residual_m: float
    residual_rad: float
    iterations: int
    reachable: bool
    kkt_residual: float
    active: tuple[str, ...]
    status: PoseStatus


def solve_pose(
    model: SceneDescription | RobotDescription | Simulation,
    tasks: Task | Sequence[Task],
    start: Array | None = None,
    settings: InverseSettings | None = None,
    *,
    most_steps: int = MOST_STEPS,
) -> PoseSolution:
    """Search from a start for the joints whose equilibrium is nearest to a goal.

    Args:
        model: A scene, which is simulated with its bases at the end of its start move; or a simulation, which
            moves to the solution (time passes) and should have no controllers of its own.
        tasks: The goal.
        start: Joints at which the search starts in [rad] or [m], shape (j,); None: the simulation's commands,
            or the scene's start pose.
        settings: Weights and limits; None: the scene's.
        most_steps: Largest number of quadratic programs.

    Raises:
        SceneError: no end effector or no joints.
        NotConvergedError: the start has no equilibrium.
    """
    if isinstance(model, Simulation):
        simulation = model
    else:
        robot = as_robot(model)
        simulation = Simulation(robot.robot_alone())
        simulation.settle(robot.start_joints, robot.start_shift)
    scene = simulation.scene
    settings = simulation.robot.inverse if settings is None else settings
    goals = list(tasks) if isinstance(tasks, Sequence) else [tasks]
    limits = far_limits(Limits.of(scene, settings, 1.0))
    joints = limits.clamp(simulation.joint_targets if start is None else np.asarray(start, dtype=float))
    if not np.array_equal(joints, simulation.joint_targets):
        simulation.settle(joints)
    return _search(simulation, goals, settings, limits, most_steps)


def _search(
    simulation: Simulation, tasks: list[Task], settings: InverseSettings, limits: Limits, most_steps: int
) -> PoseSolution:
    wide = replace(settings, max_shift=WIDE, max_turn=WIDE)
    joints = posture = simulation.joint_targets
    if settings.posture is not None:
        posture = np.array(simulation.robot.poses[settings.posture])
    reach, done, solution = limits, 0, Solution(np.zeros_like(joints), "solved", 0.0, ())
    sensitivity, before = sensitivity_of(simulation, settings), _length(tasks, effector(simulation))
    while done < most_steps:
        here, rows = linearise_robot(simulation, sensitivity, limits)
        qp = build(tasks, here, reach, wide, posture=posture, constraints=rows)
        solution, done = solve_taut(qp), done + 1
        step = float((np.abs(solution.dq) / limits.scale).max(initial=0.0))
        if solution.status != "solved" or step == 0.0:
            break
        trial, back = limits.clamp(here.joints + solution.dq), simulation.snapshot()
        worse = not _moves(simulation, trial)
        after = before if worse else _length(tasks, effector(simulation))
        if worse or (after > before and step > CERTAIN):
            simulation.restore(back)
            reach = replace(limits, step=0.5 * step * np.ones_like(joints) * limits.scale)
            continue
        joints, before = trial, after
        reach = replace(limits, step=np.minimum(2.0 * reach.step, limits.step))
        if step <= STILL:
            break
        sensitivity = sensitivity_of(simulation, settings)
    if simulation.compiled:
        with suppress(NotConvergedError):
            simulation.settle(joints)
    pose = effector(simulation)
    shift, turn = residuals(tasks, pose)
    reachable = shift <= settings.tolerance and turn <= settings.tolerance_turn
    status: PoseStatus = "stalled"
    if reachable:
        status = "reached"
    elif solution.status != "solved":
        status = solution.status
    elif is_optimal(tasks, *linearise_robot(simulation, sensitivity, limits), limits, settings):
        status = "unreachable"
    elif done >= most_steps:
        status = "gave_up"
    return PoseSolution(
        joints, pose, shift, turn, done, reachable, solution.kkt_residual, solution.active, status
    )


def linearise_robot(
    simulation: Simulation, sensitivity: Sensitivity, limits: Limits
) -> tuple[Linearisation, list[Constraint]]:
    """Return the linearised robot without slack, and rows that prevent tendons from pushing.

    Sensitivities assume that a tendon is taut; tau + T dq >= 0 keeps it so, or the limits' least tension in
    place of 0. Any pose with slack tendons is also a pose with tendons that are just taut.
    """
    taut, pulls = simulation.taut_commands()
    efforts = simulation.joint_efforts
    robot = Linearisation(sensitivity, effector(simulation), limits.clamp(taut), efforts)
    size = np.maximum(np.linalg.norm(sensitivity.effort, axis=1), 1e-300)
    names = tuple(f"{name}{SLACK}" for name, pull in zip(limits.names, pulls, strict=True) if pull)
    rows = Constraint(
        -(sensitivity.effort / size[:, None])[pulls],
        ((np.maximum(efforts, 0.0) - limits.tension) / size)[pulls],
        names,
    )
    return robot, [] if rows.inactive else [rows]


def solve_taut(qp: QP, share: float = 1.0) -> Solution:
    """Solve a program whose tendons must stay taut.

    Tendons are nearly dependent if there are more of them than bending modes of a mesh. Commands that only
    bend the body change tensions a million times less than commands that pull tendons against each other. In
    commands, the rows tau + T dq >= 0 are then nearly parallel, the active set is uncertain, and a residual
    of 1e-8 m is a pushing force of hundreds of newtons. In tensions s = tau + T dq, the rows are the bounds s
    >= 0 and T^-1 is as well conditioned as the body. Of the solutions that the task leaves open, the one with
    the least tensions is chosen.

    Args:
        qp: The program; rows that end in SLACK belong to the joints of that name.
        share: Share of the tensions left open by the task to remove.
    """
    ends = [name.removesuffix(SLACK) for name in qp.names[len(qp.q) :]]
    slack = np.array([name.endswith(SLACK) for name in qp.names[len(qp.q) :]], dtype=np.bool_)
    if not slack.any():
        return solve(qp)
    pulls = np.array([qp.names.index(ends[row]) for row in np.flatnonzero(slack)])
    matrix = np.eye(len(qp.q))
    matrix[pulls] = -qp.G[slack]
    try:
        basis = np.linalg.inv(matrix)
    except np.linalg.LinAlgError:  # a tendon without resistance
        return solve(qp)
    unit = np.ones(len(qp.q))
    unit[pulls] = 1.0 / np.linalg.norm(basis[:, pulls], axis=0)
    basis = basis * unit
    tensions = qp.h[slack] / unit[pulls]
    for loose in (0.0, LOOSE, np.inf):  # joints returning into their interval may slacken tendons
        solution = solve(_in_tensions(qp, slack, pulls, basis, tensions, share, loose))
        if solution.status == "solved":
            break
    dq = qp.scale * np.clip(basis @ solution.dq, qp.lower, qp.upper)
    return replace(solution, dq=dq)


def _in_tensions(
    qp: QP, slack: BoolArray, pulls: IndexArray, basis: Array, tensions: Array, share: float, loose: float
) -> QP:
    """Return a program for y = basis w: w are tension changes of `pulls`, and changes of other joints."""
    size = len(qp.q)
    P, q = basis.T @ qp.P @ basis, basis.T @ qp.q
    least = LEAST_TENSION * float(P.trace()) / size
    P[pulls, pulls] += least
    q[pulls] += least * share * tensions
    scale = max(float(P.trace()) / size, 1e-300)
    names = [qp.names[each] for each in pulls]
    upper = [f"{name} {'upper' if qp.at_upper[j] else 'speed'}" for j, name in zip(pulls, names, strict=True)]
    lower = [f"{name} {'lower' if qp.at_lower[j] else 'speed'}" for j, name in zip(pulls, names, strict=True)]
    taut = [f"{name}{SLACK}" for name in names]
    others = [name for name, each in zip(qp.names[size:], slack, strict=True) if not each]
    low, high = qp.lower.copy(), qp.upper.copy()
    low[pulls], high[pulls] = -np.inf, np.inf
    return QP(
        P / scale,
        q / scale,
        np.concatenate([-np.eye(size)[pulls], basis[pulls], -basis[pulls], qp.G[~slack] @ basis]),
        np.concatenate([tensions + loose, qp.upper[pulls], -qp.lower[pulls], qp.h[~slack]]),
        low,
        high,
        qp.at_lower,
        qp.at_upper,
        (*qp.names[:size], *taut, *upper, *lower, *others),
    )


def is_optimal(
    tasks: Sequence[Task],
    robot: Linearisation,
    rows: Sequence[Constraint],
    limits: Limits,
    settings: InverseSettings,
) -> bool:
    """Return whether no step within limits noticeably reduces the error: the KKT conditions hold.

    Robot and rows are those of `linearise_robot` at rest. Weights on efforts and posture are ignored, because
    they trade off the error.
    """
    alone = replace(settings, effort_weight=0.0, posture_weight=0.0, max_shift=WIDE, max_turn=WIDE)
    solution = solve_taut(build(tasks, robot, limits, alone, constraints=rows))
    before = after = 0.0
    for task in tasks:
        error = compute_step_error(task, robot.pose, alone)
        left = error - task.jacobian(robot.sensitivity.effector, robot.pose) @ solution.dq
        before += float(((task.weights * error) ** 2).sum())
        after += float(((task.weights * left) ** 2).sum())
    return solution.status == "solved" and after > (1.0 - USELESS) ** 2 * before


def _moves(simulation: Simulation, joints: Array) -> bool:
    """Move to the equilibrium at given joints by the fastest method; return False if there is none."""
    try:
        if simulation.compiled:
            walk(simulation, joints, simulation.base_shift)
        else:
            simulation.settle(joints)
    except (NotConvergedError, SolverDivergedError):
        return False
    return True


def _length(tasks: Sequence[Task], pose: Pose) -> float:
    """Return the weighted length of all errors in [m]."""
    return float(np.sqrt(sum(float(((task.weights * task.error(pose)) ** 2).sum()) for task in tasks)))


def residuals(tasks: Sequence[Task], pose: Pose) -> tuple[float, float]:
    """Return the unweighted lengths of the errors, those in [m] and those in [rad].

    Coordinates of weight 0 are ignored.
    """
    shift = turn = 0.0
    for task in tasks:
        parts = lengths(task, task.error(pose))
        shift, turn = shift + parts[0] ** 2, turn + parts[1] ** 2
    return float(np.sqrt(shift)), float(np.sqrt(turn))


def lengths(task: Task, values: Array) -> tuple[float, float]:
    """Return lengths in [m] and [rad] of a task's coordinates (k,); those of weight 0 are ignored."""
    counts, angular = task.weights > 0.0, np.array(task.angular)
    return float(np.linalg.norm(values[counts & ~angular])), float(np.linalg.norm(values[counts & angular]))


def far_limits(limits: Limits) -> Limits:
    """Return step limits that depend on the range of a linearisation, not on joint speed."""
    span = limits.upper - limits.lower
    return replace(limits, step=np.where(np.isfinite(span), STEP_SHARE * span, FREE_STEP * limits.scale))


def effector(simulation: Simulation) -> Pose:
    """Return the pose of the end effector of a scene that has one."""
    pose = simulation.effector_pose
    assert pose is not None
    return pose


def sensitivity_of(
    simulation: Simulation, settings: InverseSettings, loads: Array | None = None
) -> Sensitivity:
    """Return the derivatives by the configured back end; `loads` (n, 3) in [N] as analytic_sensitivity."""
    if settings.backend == "analytic":
        return analytic_sensitivity(simulation, loads=loads)
    return sampled_sensitivity(simulation, SAMPLE * scales(simulation.scene))


def place(simulation: Simulation, joints: Array, base_shift: float) -> None:
    """Place the model at rest at given joints, from the rest shape; where statics fail, by a walk.

    Raises:
        CommandError: wrong length or not finite.
        SolverDivergedError: both methods failed; the simulation is somewhere on the way.
    """
    simulation.reset()
    try:
        simulation.settle(joints, base_shift)
    except NotConvergedError:
        walk(simulation, joints, base_shift)


def walk(simulation: Simulation, joints: Array, base_shift: float) -> None:
    """Move joints and bases at constant speed in simulated time, ignoring limits, then wait for rest.

    Raises:
        SolverDivergedError: the simulation is somewhere on the way.
    """
    enforced, simulation.enforce_limits = simulation.enforce_limits, False
    try:
        first, shift = simulation.joint_targets, simulation.base_shift
        far = np.abs(joints - first) / scales(simulation.scene)
        travel = float(far.max(initial=0.0)) / STRIDE + abs(base_shift - shift) / SLIDE
        for part in np.linspace(0.0, 1.0, int(np.ceil(travel)) + 1)[1:]:
            simulation.base_shift = shift + part * (base_shift - shift)
            simulation.command(first + part * (joints - first))
            simulation.step()
        for _ in range(LONGEST_REST):
            simulation.step()
            if np.abs(simulation.velocities).max(initial=0.0) < AT_REST:
                break
    finally:
        simulation.enforce_limits = enforced
