"""Best joints for a goal in static equilibrium: quadratic programs, an equilibrium after each.

    dq_k = argmin QP(e(x_k), J(x_k)),    q_k+1 = q_k + dq_k,    x_k+1 the equilibrium at q_k+1

A step that does not shorten the weighted error is taken back and the next may go half as far. With compiled
steps the model walks to each equilibrium in simulated time, which is quicker; the last one is solved for.

Source: Nocedal and Wright 2006, ch. 10 (Gauss-Newton, trust region).
"""

from __future__ import annotations

from collections.abc import Sequence
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
    scales,
    solve,
    wanted,
)
from softsim_core.control.inverse.sensitivity import Sensitivity, analytic_sensitivity, sampled_sensitivity
from softsim_core.control.inverse.tasks import Task
from softsim_core.physics.mechanics import Pose
from softsim_core.scene import InverseSettings, RobotDescription, SceneDescription, as_robot
from softsim_core.simulation import Simulation

MOST_STEPS = 30
"""Quadratic programs of one search, unless told otherwise; ten are usual, several tendons want more."""

USELESS = 0.02
"""A whole step that would shorten the error by less than this part of it leads nowhere."""

STEP_SHARE = 0.5
"""Part of a joint's interval that the first step may cross."""

FREE_STEP = 0.5
"""The same for a joint without interval; it and what follows in units of Limits.scale, 1 rad or 1 m."""

STILL = 1e-6
"""A last step below this ends the search."""

CERTAIN = 1e-4
"""A step below this is not taken back: what changes then is rounding."""

STRIDE = 0.05
"""Largest joint travel of a time step of a walk."""

SAMPLE = 1e-3
"""To both sides of a joint, equilibria are sampled this far away."""

SLIDE = 0.002
"""Travel in [m] of the bases in a time step of a walk."""

AT_REST = 1e-8
"""A walk ends when no node is faster than this, in [m/s]."""

LOOSE = 1e-6
"""How far in [m] many tendons that say nearly the same may be from taut, where no program keeps all so."""

LEAST_TENSION = 1e-10
"""Weight of tensions in a program in tensions, as a part of its mean curvature: it decides what the task
leaves open."""

SLACK = " slack"
"""Ends the names of rows that keep a tendon taut."""

LONGEST_REST = 300
"""Or after this many time steps at its end."""


WIDE: Final = 1e3
"""In [m] and [rad]: the step of a search is limited, not its target."""

PoseStatus: TypeAlias = Literal["reached", "unreachable", "gave_up", "stalled", "infeasible", "not_converged"]


@dataclass(frozen=True, slots=True, eq=False)
class PoseSolution:
    """Joints for a goal.

    Attributes:
        joints: Commands in [rad] or [m], shape (j,), inside the limits.
        pose: The effector there, at rest.
        residual_m, residual_rad: Length of the error in [m] and in [rad] over the tasks' coordinates.
        iterations: Quadratic programs solved.
        reachable: Whether the residual is within the settings' tolerance: True only where it was shown.
        kkt_residual: Of the last program, in [rad] or [m].
        active: Names of the limits that hold the last step back.
        status: "reached" (within the settings' tolerance); "unreachable" (no step within the limits leads
            nearer); "gave_up" (the programs ran out); "stalled" (a step promises to lead nearer, and none
            does); "infeasible" or "not_converged" (the last program, see Solution).
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
    """The joints whose equilibrium is nearest to a goal, from a start.

    Args:
        model: A scene, which is simulated with its bases where its start move leaves them; or a simulation,
            which goes to the solution (time passes) and should have no controllers of its own.
        tasks: The goal.
        start: Joints to search from in [rad] or [m], shape (j,); None: the simulation's commands, or the
            scene's start pose.
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
        here, rows = linearised(simulation, sensitivity, limits)
        qp = build(tasks, here, reach, wide, posture=posture, constraints=rows)
        solution, done = solve_taut(qp), done + 1
        step = float((np.abs(solution.dq) / limits.scale).max(initial=0.0))
        if solution.status != "solved" or step == 0.0:
            break
        trial, back = limits.clamp(here.joints + solution.dq), simulation.snapshot()
        worse = not _goes(simulation, trial)
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
        _settles(simulation, joints)
    pose = effector(simulation)
    shift, turn = residuals(tasks, pose)
    reachable = shift <= settings.tolerance and turn <= settings.tolerance_turn
    status: PoseStatus = "stalled"
    if reachable:
        status = "reached"
    elif solution.status != "solved":
        status = solution.status
    elif is_optimal(tasks, *linearised(simulation, sensitivity, limits), limits, settings):
        status = "unreachable"
    elif done >= most_steps:
        status = "gave_up"
    return PoseSolution(
        joints, pose, shift, turn, done, reachable, solution.kkt_residual, solution.active, status
    )


def linearised(
    simulation: Simulation, sensitivity: Sensitivity, limits: Limits
) -> tuple[Linearisation, list[Constraint]]:
    """A robot as programs of a search see it, slack taken up, and rows that keep tendons from pushing.

    Sensitivities take a tendon to be taut: with tau + T dq >= 0 it stays so. A pose with slack tendons is
    one with tendons that are just taut, too.
    """
    taut, pulls = simulation.taut_commands()
    efforts = simulation.joint_efforts
    robot = Linearisation(sensitivity, effector(simulation), limits.clamp(taut), efforts)
    size = np.maximum(np.linalg.norm(sensitivity.effort, axis=1), 1e-300)
    names = tuple(f"{name}{SLACK}" for name, pull in zip(limits.names, pulls, strict=True) if pull)
    rows = Constraint(
        -(sensitivity.effort / size[:, None])[pulls], (np.maximum(efforts, 0.0) / size)[pulls], names
    )
    return robot, [] if rows.inactive else [rows]


def solve_taut(qp: QP, share: float = 1.0) -> Solution:
    """The increments of a program whose tendons stay taut.

    More tendons than a mesh has ways to bend are nearly dependent: commands that only bend the body change
    tensions by a millionth of what commands do that pull tendons against each other. In commands the rows
    tau + T dq >= 0 are nearly parallel, no active set is certain, and a residual of 1e-8 m is a push of
    hundreds of newtons. In tensions s = tau + T dq they are the bounds s >= 0, T^-1 is as well conditioned as
    the body, and of what the task leaves open the least tensions are taken.

    Args:
        qp: The program; rows that end in SLACK belong to the joints of that name.
        share: Of the tensions that the task leaves open to take away.
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
    except np.linalg.LinAlgError:  # a tendon that nothing holds
        return solve(qp)
    unit = np.ones(len(qp.q))
    unit[pulls] = 1.0 / np.linalg.norm(basis[:, pulls], axis=0)
    basis = basis * unit
    tensions = qp.h[slack] / unit[pulls]
    for loose in (0.0, LOOSE, np.inf):  # joints that come back into their interval may let tendons go
        solution = solve(_in_tensions(qp, slack, pulls, basis, tensions, share, loose))
        if solution.status == "solved":
            break
    dq = qp.scale * np.clip(basis @ solution.dq, qp.lower, qp.upper)
    return replace(solution, dq=dq)


def _in_tensions(
    qp: QP, slack: BoolArray, pulls: IndexArray, basis: Array, tensions: Array, share: float, loose: float
) -> QP:
    """A program for y = basis w, with w the changes of tension of the joints `pulls`, and of other joints."""
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
    """Whether no step within limits shortens the error noticeably: a point where the KKT conditions hold.

    Args:
        tasks: The goal.
        robot: At rest, see `linearised`.
        rows: That belong to it.
        limits: Of a step.
        settings: Their weights on efforts and posture, which an error may be traded for, do not count.
    """
    alone = replace(settings, effort_weight=0.0, posture_weight=0.0, max_shift=WIDE, max_turn=WIDE)
    solution = solve_taut(build(tasks, robot, limits, alone, constraints=rows))
    before = after = 0.0
    for task in tasks:
        error = wanted(task, robot.pose, alone)
        left = error - task.jacobian(robot.sensitivity.effector, robot.pose) @ solution.dq
        before += float(((task.weights * error) ** 2).sum())
        after += float(((task.weights * left) ** 2).sum())
    return solution.status == "solved" and after > (1.0 - USELESS) ** 2 * before


def _goes(simulation: Simulation, joints: Array) -> bool:
    """Go to the equilibrium at given joints the quickest way; False: there is none."""
    if not simulation.compiled:
        return _settles(simulation, joints)
    try:
        walk(simulation, joints, simulation.base_shift)
    except SolverDivergedError:
        return False
    return True


def _settles(simulation: Simulation, joints: Array) -> bool:
    try:
        simulation.settle(joints)
    except NotConvergedError:
        return False
    return True


def _length(tasks: Sequence[Task], pose: Pose) -> float:
    """Weighted length of all errors in [m]."""
    return float(np.sqrt(sum(float(((task.weights * task.error(pose)) ** 2).sum()) for task in tasks)))


def residuals(tasks: Sequence[Task], pose: Pose) -> tuple[float, float]:
    """Lengths of the errors that are lengths [m] and that are angles [rad], unweighted.

    Coordinates of weight 0 do not count.
    """
    shift = turn = 0.0
    for task in tasks:
        parts = lengths(task, task.error(pose))
        shift, turn = shift + parts[0] ** 2, turn + parts[1] ** 2
    return float(np.sqrt(shift)), float(np.sqrt(turn))


def lengths(task: Task, values: Array) -> tuple[float, float]:
    """Lengths in [m] and [rad] of values of a task's coordinates (k,); those of weight 0 do not count."""
    counts, angular = task.weights > 0.0, np.array(task.angular)
    return float(np.linalg.norm(values[counts & ~angular])), float(np.linalg.norm(values[counts & angular]))


def far_limits(limits: Limits) -> Limits:
    """Limits of a step that speed does not hold back, but what a linearisation is good for."""
    span = limits.upper - limits.lower
    return replace(limits, step=np.where(np.isfinite(span), STEP_SHARE * span, FREE_STEP * limits.scale))


def effector(simulation: Simulation) -> Pose:
    """Pose of the end effector of a scene that has one."""
    pose = simulation.effector_pose
    assert pose is not None
    return pose


def sensitivity_of(
    simulation: Simulation, settings: InverseSettings, loads: Array | None = None
) -> Sensitivity:
    """Derivatives by the back end that the settings name; `loads` (n, 3) in [N] as analytic_sensitivity."""
    if settings.backend == "analytic":
        return analytic_sensitivity(simulation, loads=loads)
    return sampled_sensitivity(simulation, SAMPLE * scales(simulation.scene))


def place(simulation: Simulation, joints: Array, base_shift: float) -> None:
    """Stand at rest at given joints, reached from the rest shape; where statics fail, by walking there.

    Raises:
        CommandError: wrong length or not finite.
        SolverDivergedError: neither way works; the simulation is somewhere on the way.
    """
    simulation.reset()
    try:
        simulation.settle(joints, base_shift)
    except NotConvergedError:
        walk(simulation, joints, base_shift)


def walk(simulation: Simulation, joints: Array, base_shift: float) -> None:
    """Move joints and bases evenly in simulated time, limits or not, then wait for rest.

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
