"""Sensitivity of effector and joint efforts to the joint commands, in static equilibrium.

With S the static stiffness on free frames f and joints j (free nodes eliminated, drives D included), a change
du of the commands moves joints and frames by

    S_ff df + S_fj dtheta = 0,    (S_jj - S_jf S_ff^-1 S_fj) dtheta = D du   (compliant; else dtheta = du)

Source: implicit function theorem on the equilibrium of softsim_core.physics.dynamics.statics.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.linalg.lapack import dgesv

from softsim_core.base import Array, SceneError
from softsim_core.physics.actuation import drive_stiffness
from softsim_core.physics.mechanics import Rows, no_rows, rotation_log
from softsim_core.simulation import Simulation


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivity:
    """Derivatives with respect to the joint commands.

    Attributes:
        effector: Shift in [m] and spin in [rad] (world axes) of the effector per unit of each command, (6,
            j).
        effort: Change of the joint efforts in [N m] or [N] per unit of each command, (j, j).
        loaded: Shift in [m] and spin in [rad] of the effector under the given loads, (6,).
    """

    effector: Array
    effort: Array
    loaded: Array = field(default_factory=lambda: np.zeros(6))


def analytic_sensitivity(
    simulation: Simulation, contact_stiffness: Array | None = None, loads: Array | None = None
) -> Sensitivity:
    """Return the sensitivity effector = -S_ff^-1 S_fj, effort = S_jj - S_jf S_ff^-1 S_fj, at rest or moving.

    It is exact for the law `polar`. For `qr`, the compiled step uses the derivative of `polar` at the same
    state, which is accurate enough for control with the `qr` model in the loop. `sampled_sensitivity` and
    statics use `qr` itself.

    Args:
        simulation: Has at least one joint and an end effector.
        contact_stiffness: Stiffness that present contacts add to the reduced coordinates, shape (b, b), in
            the order of Simulation.reduced_stiffness; None: none.
        loads: Forces in [N] on the nodes, shape (n, 3), for the attribute `loaded`; None: none.

    Raises:
        SceneError: no end effector.
        LinAlgError: the state is at a branch of equilibria; no derivative exists.
    """
    first = 6 * _effector_index(simulation)
    model = simulation.model
    rows = no_rows() if loads is None else Rows(np.array([0, len(loads)]), np.arange(len(loads)), loads)
    stiffness, arriving, _ = simulation.condensed_tangent(rows)
    if contact_stiffness is not None:
        stiffness = stiffness + contact_stiffness
    frames = 6 * len(model.frame_names)
    coupling = stiffness[:frames, frames:]
    _, _, answer, singular = dgesv(stiffness[:frames, :frames], np.hstack([-coupling, arriving[:frames]]))
    if singular:
        raise np.linalg.LinAlgError("the effector has no stiffness here")
    follow, loaded = answer[:, : coupling.shape[1]], answer[:, coupling.shape[1] :].sum(axis=1)
    effort = stiffness[frames:, frames:] + coupling.T @ follow  # the tangent is symmetric
    if len(model.compliant_joints):
        drive = drive_stiffness(model)
        compliant = drive > 0.0  # others follow their command exactly
        matrix = np.where(compliant[:, None], effort, np.eye(len(drive)))
        pushed = (arriving[frames:] + follow.T @ arriving[:frames]).sum(axis=1)
        loaded = loaded + follow @ np.linalg.solve(matrix, np.where(compliant, pushed, 0.0))
        moved = np.linalg.solve(matrix, np.diag(np.where(compliant, drive, 1.0)))
        follow, effort = follow @ moved, (effort - np.diag(drive)) @ moved
    gains = simulation.command_gains()
    by_effort = gains == 0.0  # joints with effort commands
    effort = np.where(
        by_effort[:, None], np.eye(len(gains)), effort / np.where(by_effort, 1.0, gains)[:, None]
    )
    return Sensitivity(follow[first : first + 6], effort, loaded[first : first + 6])


def sampled_sensitivity(simulation: Simulation, step: float | Array = 1e-3) -> Sensitivity:
    """Return (x(u + h e_k) - x(u - h e_k)) / 2 h of equilibria around the present commands.

    The simulation is not changed. Two equilibria per joint make this a hundred times slower than the analytic
    sensitivity, but free of its assumptions.

    Args:
        simulation: Has at least one joint and an end effector.
        step: h in the units of the joint commands, for all joints or for each, shape (j,).

    Raises:
        SceneError: no end effector.
        NotConvergedError: an equilibrium was not found.
    """
    effector = _effector_index(simulation)
    commands = simulation.joint_targets
    columns, efforts = [], []
    steps = np.broadcast_to(step, commands.shape)
    for k in range(len(commands)):
        offset = np.zeros_like(commands)
        offset[k] = steps[k]
        ahead = simulation.equilibrium(commands + offset).state
        behind = simulation.equilibrium(commands - offset).state
        shift = ahead.frame_positions[effector] - behind.frame_positions[effector]
        turn = rotation_log(ahead.frame_rotations[effector] @ behind.frame_rotations[effector].T)
        columns.append(np.concatenate([shift, turn]) / (2.0 * steps[k]))
        efforts.append((ahead.joint_efforts - behind.joint_efforts) / (2.0 * steps[k]))
    return Sensitivity(np.column_stack(columns), np.column_stack(efforts))


def _effector_index(simulation: Simulation) -> int:
    """Return the index of the free frame that is the end effector."""
    name = simulation.scene.effector
    if name is None or not simulation.model.joints:
        raise SceneError(
            f"scene {simulation.scene.name} has no end effector moved by joints: inverse control needs "
            "`effector` and `joints`"
        )
    return simulation.model.frame_names.index(name)
