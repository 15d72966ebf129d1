"""How an equilibrium moves with joint commands and with forces on given rows, to first order.

With S, Z and W of actuator_statics.condensed, u the free frames and joints on drives, p all other joints, and
D the stiffness of the drives, a force f on the rows and a change dc of the commands move

    du = S_uu^-1 (Z_u f + D dc_u - S_up dc_p),    dy = Z_u^T du + Z_p^T dc_p + W f

Source: implicit function theorem on the equilibrium of softsim_core.dynamics.statics.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softsim_core.actuation.joint_drive import drive_stiffness
from softsim_core.arrays import Array
from softsim_core.dynamics.stepper import Condensed
from softsim_core.mechanics.model import Model


@dataclass(frozen=True, slots=True, eq=False)
class StaticResponse:
    """Derivatives of an equilibrium; of its r rows, and of its b degrees of freedom of frames and joints.

    Attributes:
        rows_by_command: Shift of each row a unit of each joint's command, shape (r, j).
        rows_by_row: Shift of each row a unit of force on each row in [m/N], shape (r, r).
        reduced_by_command: Change of frames and joints a unit of each joint's command, shape (b, j).
        reduced_by_row: The same a unit of force on each row, shape (b, r).
    """

    rows_by_command: Array
    rows_by_row: Array
    reduced_by_command: Array
    reduced_by_row: Array


def response_of(model: Model, condensed: Condensed) -> StaticResponse:
    """The response, from the condensed static tangent.

    Raises:
        LinAlgError: frames or joints have no stiffness here.
    """
    stiffness, arriving, compliance = condensed
    drive = drive_stiffness(model)
    first = len(stiffness) - len(drive)
    solved = np.append(np.ones(first, dtype=bool), drive > 0.0)
    by_command = np.zeros((len(stiffness), len(drive)))
    by_command[first:] = np.eye(len(drive))
    asked = -stiffness[:, first:].copy()
    asked[:, drive > 0.0] = 0.0
    asked[first:] += np.diag(drive)
    by_row = np.zeros_like(arriving)
    inner = stiffness[np.ix_(solved, solved)]
    if len(inner):
        answer = np.linalg.solve(inner, np.hstack([asked[solved], arriving[solved]]))
        by_command[solved], by_row[solved] = answer[:, : len(drive)], answer[:, len(drive) :]
    return StaticResponse(arriving.T @ by_command, compliance + arriving.T @ by_row, by_command, by_row)
