"""Where the joints of a rigid chain, such as an arm, must be for its last frame to stand somewhere."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.optimize import least_squares

from softsim_core.arrays import Array
from softsim_core.errors import NotReachedError
from softsim_core.mechanics.model import Model
from softsim_core.mechanics.pose import rotation_log

LEVER_M: Final = 0.1
"""A turn counts as what it moves at this distance, in [m]."""
CLOSE_M: Final = 1e-5
"""A frame that is this close is there, in [m]."""
_FIXED: Final = 1e-8
"""A joint whose limits are not farther apart does not move."""


def reach(
    model: Model,
    joint: str,
    position: Sequence[float] | Array,
    rotation: Array,
    start: Sequence[float] | Array,
) -> Array:
    """Joint positions at which a joint's frame stands at a place; joints that do not carry it stay.

    Args:
        model: The model, its bases where the scene has them.
        joint: Name of the joint; it and those that carry it move, within their limits.
        position: Where the origin of the frame that it moves shall be in [m], shape (3,).
        rotation: How that frame shall be turned, shape (3, 3).
        start: Joint positions to begin at, in [rad] or [m]; of several answers the one near them is found.

    Returns:
        Positions of all joints, shape (j,).

    Raises:
        NotReachedError: no positions were found that bring it nearer than CLOSE_M; says how near it came.

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
