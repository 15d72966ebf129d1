r"""Which poses to measure next: those whose rows would tell most of what is not yet known.

Rows that are there, and one more, tell of the parameters p, beside frame and sensor points a of its session,
:math:`I = \sum_i J_i^T J_i / \sigma^2` with the slopes of errors by both; of p alone :math:`I_{pp} - I_{pa}
I_{aa}^{-1} I_{ap}`. Of candidates, spread evenly about the commands that were measured, one after another
is taken with which the determinant of this grows most.

Source: Fedorov 1972, Theory of optimal experiments (D-optimality, one point after another).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from softsim_core.arrays import Array
from softsim_core.errors import DataError
from softsim_core.identification.alignment import Alignment, sensed
from softsim_core.identification.fit import Calibration
from softsim_core.identification.problem import Problem
from softsim_core.identification.replay import Near, Prediction, equilibria
from softsim_core.identification.validation import compared
from softsim_core.mechanics.pose import cross_matrix

BEYOND = 0.1
"""Part of the measured range of commands by which candidates reach beyond it."""


@dataclass(frozen=True, slots=True, eq=False)
class NextPoses:
    """Poses that are worth measuring.

    Attributes:
        session: That which they would be added to.
        joints: Names of the joints.
        commands: The poses, the best first, shape (n, j).
        errors: Standard errors of the parameters as they are, and as they would be with the first, the first
            two, and so on, shape (n + 1, p).
    """

    session: str
    joints: tuple[str, ...]
    commands: Array
    errors: Array


def next_poses(
    result: Calibration,
    count: int = 5,
    candidates: int = 64,
    seed: int = 0,
    done: Callable[[int, int], None] | None = None,
) -> NextPoses:
    """Poses that would tell most of the parameters.

    Args:
        result: The calibration, not interrupted.
        count: How many poses.
        candidates: Among how many.
        seed: Spreads the candidates.
        done: Told how many replays of the candidates are done.

    Raises:
        DataError: no session is of poses at rest.
    """
    problem, chosen = result.problem, _at_rest(result)
    session = problem.misfit.sessions[chosen]
    best = (result.values - problem.low) / problem.span
    around = problem.look_around(best)
    slopes, _ = problem.information(best)
    replayed = [around.here[chosen], *(each[chosen] for each in around.moved)]
    there_are = session.fitting & np.logical_and.reduce([each.reached for each in replayed])
    alignment = compared(session, replayed[0]).alignment
    assert alignment is not None
    fit = session.description.alignment
    aligned = alignment, (fit.frame, fit.point)
    measured = _slopes(replayed, around.steps, *aligned)[there_are]
    commands = _candidates(result, chosen, candidates, seed)
    offered = _slopes(_replayed(result, chosen, commands, around.steps, done), around.steps, *aligned)
    offered = offered / problem.noise
    reached = np.isfinite(offered).all(axis=(1, 2))
    if not reached.any():
        raise DataError(f"session {session.name}", "commands", "no candidate has an equilibrium")
    size = len(best)
    flat = measured.reshape(-1, measured.shape[-1]) / problem.noise
    information = flat.T @ flat
    information[:size, :size] += _from_others(problem, slopes, chosen)
    taken: list[int] = []
    errors = [_errors(information, size)]
    each = np.einsum("nra,nrb->nab", offered, offered)
    for _ in range(min(count, int(reached.sum()))):
        left_over = [k for k in np.flatnonzero(reached).tolist() if k not in taken]
        taken.append(max(left_over, key=lambda k: _worth(information + each[k], size)))
        information = information + each[taken[-1]]
        errors.append(_errors(information, size))
    names = problem.misfit.robot(chosen, result.values).joint_names
    return NextPoses(session.name, names, commands[taken], np.array(errors) * problem.span)


def _at_rest(result: Calibration) -> int:
    """Number of the first session whose rows stand for themselves."""
    for k, session in enumerate(result.problem.misfit.sessions):
        if session.times is None:
            return k
    raise DataError(f"calibration {result.description.name}", "", "has no session of poses at rest")


def _candidates(result: Calibration, chosen: int, count: int, seed: int) -> Array:
    """Commands about those that a session measured, within the limits of joints, shape (n, j); Sobol 1967."""
    misfit = result.problem.misfit
    robot, session = misfit.robot(chosen, result.values), misfit.sessions[chosen]
    measured = session.commands(robot)[session.fitting]
    low, high = measured.min(axis=0), measured.max(axis=0)
    margin = BEYOND * (high - low)
    low = np.maximum(low - margin, [joint.limits.lower for joint in robot.joints])
    high = np.minimum(high + margin, [joint.limits.upper for joint in robot.joints])
    even = qmc.Sobol(len(low), seed=seed).random(2 ** int(np.ceil(np.log2(count))))[:count]
    return np.asarray(low + even * (high - low))


def _replayed(
    result: Calibration, chosen: int, commands: Array, steps: Array, done: Callable[[int, int], None] | None
) -> list[Prediction]:
    """Candidates with the parameters found, then with each moved by its step in parts of the bounds."""
    problem, found = result.problem, (result.values - result.problem.low) / result.problem.span
    sensors = problem.misfit.sessions[chosen].description.sensors
    near: Near = {}
    replayed: list[Prediction] = []
    for each in (np.zeros(len(steps)), *np.diag(steps)):
        model = problem.misfit.robot(chosen, problem.values(found + each))
        replayed.append(equilibria(model, sensors, commands, near=near))
        if replayed[-1].stopped:
            raise KeyboardInterrupt
        if done is not None:
            done(len(replayed), len(steps) + 1)
    return replayed


def _from_others(problem: Problem, slopes: Array, chosen: int) -> Array:
    """What all other sessions, each aligned for itself, and priors tell of the parameters, shape (p, p)."""
    counts = [3 * len(each.description.sensors) * int(each.fitting.sum()) for each in problem.misfit.sessions]
    first = sum(counts[:chosen])
    other = np.delete(slopes, np.arange(first, first + counts[chosen]), axis=0)
    priors = problem.prior_slopes
    return np.asarray(other.T @ other + priors.T @ priors)


def _slopes(
    replayed: Sequence[Prediction], steps: Array, alignment: Alignment, fit: tuple[bool, bool]
) -> Array:
    """Slopes of errors by parameters, then by frame and points where these are fitted, shape (k, 3 s, p + a).

    Args:
        replayed: The rows, then with each parameter moved by its step.
        steps: In parts of the bounds, shape (p,).
        alignment: Of the session.
        fit: Whether the frame is fitted, and the points.
    """
    here, *moved = replayed
    points, (count, sensors) = alignment.points, here.positions.shape[:2]
    seen = sensed(here.positions, here.rotations, points)
    columns = [
        (sensed(each.positions, each.rotations, points) - seen) / step
        for each, step in zip(moved, steps, strict=True)
    ]
    frame, point = fit
    if frame:
        centre = np.nanmean(seen, axis=(0, 1))
        turned = np.stack([np.stack([cross_matrix(each) for each in row]) for row in seen - centre])
        columns += [*np.moveaxis(turned, -1, 0)]
        columns += [np.broadcast_to(-axis, seen.shape) for axis in np.eye(3)]
    if point:
        for s in range(sensors):
            of = np.zeros((count, sensors, 3, 3))
            of[:, s] = here.rotations[:, s]
            columns += [*np.moveaxis(of, -1, 0)]
    return np.asarray(np.stack(columns, axis=-1).reshape(count, 3 * sensors, -1))


def _alone(information: Array, size: int) -> Array:
    """Information of the first `size` numbers when the others are fitted beside, (size, size)."""
    if len(information) == size:
        return information
    across = information[:size, size:]
    return np.asarray(
        information[:size, :size]
        - across @ np.linalg.pinv(information[size:, size:], hermitian=True) @ across.T
    )


def _worth(information: Array, size: int) -> float:
    sizes = np.linalg.eigvalsh(_alone(information, size))
    return float(np.log(np.maximum(sizes, 1e-12)).sum())


def _errors(information: Array, size: int) -> Array:
    alone = _alone(information, size)
    sizes, axes = np.linalg.eigh(alone)
    return np.asarray(np.sqrt((axes**2 / np.maximum(sizes, 1e-12)).sum(axis=1)))
