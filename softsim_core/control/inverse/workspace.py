"""Reachability of an effector: joints of a rigid chain for a pose, and the workspace of a soft robot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial import ConvexHull, QhullError
from scipy.stats import qmc

from softsim_core.base import Array, NotConvergedError, NotReachedError, SceneError, listing
from softsim_core.control.inverse.closed_loop import tilts_of
from softsim_core.control.inverse.sensitivity import analytic_sensitivity
from softsim_core.control.inverse.static import effector
from softsim_core.physics.mechanics import Model, rotation_log, rotation_of
from softsim_core.scene import RobotDescription, SceneDescription, as_robot
from softsim_core.simulation import Simulation

LEVER_M: Final = 0.1
"""Length in [m] that converts an angle to a displacement."""
CLOSE_M: Final = 1e-5
"""Distance in [m] within which a frame counts as at its goal."""
_FIXED: Final = 1e-8
"""A joint with limits no farther apart than this does not move."""


def reach(
    model: Model,
    joint: str,
    position: Sequence[float] | Array,
    rotation: Array,
    start: Sequence[float] | Array,
) -> Array:
    """Return joint positions at which a joint's frame is at a pose; joints that do not carry it stay.

    Args:
        model: The model, with its bases as in the scene.
        joint: Name of the joint; it and the joints that carry it move, within their limits.
        position: Goal of the origin of the frame that it moves in [m], shape (3,).
        rotation: Goal rotation of that frame, shape (3, 3).
        start: Initial joint positions in [rad] or [m]; of several solutions the one near them is found.

    Returns:
        Positions of all joints, shape (j,).

    Raises:
        NotReachedError: no positions were found that bring it nearer than CLOSE_M; reports the distance.

    Source: bounded nonlinear least squares (Branch, Coleman and Li 1999) on position and rotation vector.
    """
    names = [each.name for each in model.joints]
    index, state = names.index(joint), model.rest_state()
    chain = model.chain(index)
    limits = [model.joints[j].limits for j in chain]
    state.joint_positions[:] = start
    chain = [j for j, each in zip(chain, limits, strict=True) if each.upper - each.lower > _FIXED]
    limits = [model.joints[j].limits for j in chain]

    def missing(angles: Array) -> Array:
        state.joint_positions[chain] = angles
        origin, turn = model.joint_frame(index, state)
        return np.concatenate([origin - position, LEVER_M * rotation_log(turn @ rotation.T)])

    lower, upper = (np.array([getattr(each, side) for each in limits]) for side in ("lower", "upper"))
    begin = np.clip(np.asarray(start, dtype=float)[chain], lower + 0.1 * _FIXED, upper - 0.1 * _FIXED)
    found = least_squares(missing, begin, bounds=(lower, upper), xtol=1e-12, ftol=1e-14, gtol=1e-14)
    miss = float(np.abs(missing(found.x)).max())
    if not miss < CLOSE_M:
        raise NotReachedError(joint, tuple(np.round(position, 4).tolist()), miss)
    return state.joint_positions.copy()


MOST_CORNERS = 64
"""All corners of the joint box are sampled if there are no more than these."""

Progress = Callable[[int, int], None]
"""Called with finished and total number of samples."""


@dataclass(frozen=True, slots=True, eq=False)
class Workspace:
    """Equilibria of a robot, k of them.

    Attributes:
        base_shift: Shift in [m] of the joint bases.
        joints: Joint positions in [rad] or [m], shape (k, j).
        positions: Effector positions in [m], shape (k, 3).
        quaternions: Effector orientations (x, y, z, w), shape (k, 4).
        tilts: Tilts about x and y in [rad], shape (k, 2).
        gains: Singular values of the derivative of the position by the joints, largest first, in [m/rad] or
            [m/m], shape (k, min(3, j)).
        efforts: Effort of each drive in the pose, in [N m] or [N], shape (k, j).
        failed: Joint positions at which no equilibrium was found, shape (f, j).
    """

    base_shift: float
    joints: Array
    positions: Array
    quaternions: Array
    tilts: Array
    gains: Array
    efforts: Array
    failed: Array

    @property
    def volume(self) -> float:
        """Volume of the convex hull of the positions in [m^3]; 0 where they lie in a plane."""
        return self.volume_within(np.inf)

    def volume_within(self, most_effort: float) -> float:
        """Return the volume in [m^3] of the poses with no effort above `most_effort` in [N m] or [N]."""
        within = np.abs(self.efforts).max(axis=1, initial=0.0) <= most_effort
        try:
            return float(ConvexHull(self.positions[within]).volume)
        except (QhullError, ValueError):
            return 0.0

    @property
    def extents(self) -> Array:
        """Least and largest x, y, z in [m], shape (2, 3)."""
        return np.array([self.positions.min(axis=0), self.positions.max(axis=0)])

    @property
    def tilt_range(self) -> Array:
        """Least and largest tilt about x and y in [rad], shape (2, 2)."""
        return np.array([self.tilts.min(axis=0), self.tilts.max(axis=0)])

    @property
    def conditions(self) -> Array:
        """Ratio of largest to smallest gain, >= 1, shape (k,); 1 moves equally well in every direction."""
        return np.asarray(self.gains[:, 0] / np.maximum(self.gains[:, -1], np.finfo(float).tiny))

    def summary(self) -> dict[str, object]:
        """Return a summary as plain numbers, with units in the names."""
        low, high = self.extents.tolist()
        tilt_low, tilt_high = self.tilt_range.tolist()
        conditions = self.conditions
        best = int(np.argmin(conditions))
        return {
            "samples": len(self.joints),
            "failed": len(self.failed),
            "base_shift_m": self.base_shift,
            "volume_m3": self.volume,
            "x_m": [low[0], high[0]],
            "y_m": [low[1], high[1]],
            "z_m": [low[2], high[2]],
            "tilt_x_rad": [tilt_low[0], tilt_high[0]],
            "tilt_y_rad": [tilt_low[1], tilt_high[1]],
            "condition_best": float(conditions[best]),
            "condition_median": float(np.median(conditions)),
            "condition_worst": float(conditions.max()),
            "best_joints": self.joints[best].tolist(),
            "best_position_m": self.positions[best].tolist(),
        }


def sample_workspace(
    scene: SceneDescription | RobotDescription,
    samples: int = 200,
    base_shift: float | None = None,
    progress: Progress | None = None,
) -> Workspace:
    """Sample equilibria at joints spread evenly over their limits, corners included; deterministic.

    Args:
        scene: A scene with joints, all limited, and an end effector.
        samples: Number of samples, >= 4.
        base_shift: Shift in [m] of the joint bases; None: where the robot's start move leaves them.
        progress: Called after each sample.

    Raises:
        SceneError: no joints, no effector, a joint without limits, too few samples, or no equilibrium at all.
    """
    robot = as_robot(scene)
    shift = robot.start_shift if base_shift is None else base_shift
    targets = _in_short_steps(_spread(robot.scene, samples), np.array(robot.start_joints))
    simulation = Simulation(robot.robot_alone())
    rows: list[tuple[Array, ...]] = []
    failed: list[Array] = []
    for done, joints in enumerate(targets, start=1):
        try:
            _settle(simulation, joints, shift)
        except NotConvergedError:
            failed.append(joints)
        else:
            pose = effector(simulation)
            tilts = tilts_of(rotation_of(pose.quaternion_xyzw))[:2]
            gains = np.linalg.svd(analytic_sensitivity(simulation).effector[:3], compute_uv=False)
            efforts = simulation.joint_efforts
            rows.append((joints, pose.position, pose.quaternion_xyzw, np.array(tilts), gains, efforts))
        if progress is not None:
            progress(done, len(targets))
    if not rows:
        raise SceneError(
            f"{robot.name}: no equilibrium at any of {samples} joint positions; check its limits"
        )
    missing = np.array(failed).reshape(-1, len(robot.joints))
    return Workspace(shift, *(*map(np.array, zip(*rows, strict=True)), missing))


def _spread(scene: SceneDescription, samples: int) -> Array:
    """Return joint positions, shape (samples, j): corners of the box, then a Halton sequence."""
    if scene.effector is None or not scene.joints:
        raise SceneError(f"{scene.name} needs joints and an effector to have a workspace")
    if samples < 4:
        raise SceneError(f"a workspace needs 4 samples or more, not {samples}")
    lower = np.array([joint.limits.lower for joint in scene.joints])
    upper = np.array([joint.limits.upper for joint in scene.joints])
    endless = ~(np.isfinite(lower) & np.isfinite(upper))
    if endless.any():
        names = listing(joint.name for joint, open_ in zip(scene.joints, endless, strict=True) if open_)
        raise SceneError(f"{scene.name}: joints without limits: {names}; give them lower and upper limits")
    count = len(lower)
    few = 2**count <= MOST_CORNERS
    corners = np.array(list(product((0.0, 1.0), repeat=count)) if few else np.zeros((0, count)))
    corners = corners[: samples // 2]
    inner = qmc.Halton(count, scramble=False).random(samples - len(corners) + 1)[1:]  # the first is a corner
    return np.asarray(lower + (upper - lower) * np.vstack([corners, inner]))


def _in_short_steps(points: Array, start: Array) -> Array:
    """Order points so that each is the nearest of those left: a static solve then starts near its end."""
    left, here, order = list(range(len(points))), start, []
    while left:
        nearest = min(left, key=lambda index: float(np.linalg.norm(points[index] - here)))
        left.remove(nearest)
        order.append(nearest)
        here = points[nearest]
    return points[order]


def _settle(simulation: Simulation, joints: Array, shift: float) -> None:
    """Solve the equilibrium starting from the last one; if that fails, starting from the rest shape."""
    try:
        simulation.settle(joints, shift)
    except NotConvergedError:
        simulation.reset()
        simulation.settle(joints, shift)
