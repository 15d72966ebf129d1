"""Static equilibrium of a model: Newton's method with the exact tangent, line search and load stepping.

With q the free nodes, free frames and compliant joints, x = x(q) the nodes, J = dx/dq and f the forces on
nodes (elastic, weight, soft fixings, external, actuators), the residual is r(q) = J^T f + drive springs, and
an iteration solves

    (J^T K J - G) dq = r,    K = -df/dx (exact),    G = (dJ^T/dq) f of the rigid regions

and adds dq, all or part of it (see WAYS). Actuators add H^T t to f, their geometric stiffness to the tangent,
and s - q + c t to what is solved; see actuator_statics. A load that is too far
is approached in parts: joint targets and base shift move evenly, and the residual of the first state is taken
away evenly; where that takes long, inertia restrains the steps instead (see StaticProblem.restrained). Where
the first state could not stay whatever held it (bodies may be drawn far from rest), such steps come first, or
it is let go before joints and base move. What comes out is checked: the last step is tiny, the equilibrium
stable, and no element was turned inside out.

Source: Deuflhard 2004, Newton methods for nonlinear problems (error-oriented line search, continuation).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from softsim_core.actuation.actuators import Actuators
from softsim_core.dynamics.static_problem import StaticProblem
from softsim_core.errors import NotConvergedError
from softsim_core.linalg.linear_solver import LinearSolver
from softsim_core.linalg.solvers import linear_solver
from softsim_core.mechanics.control import Control, Parameters
from softsim_core.mechanics.model import Model
from softsim_core.mechanics.state import State

SMALLEST_PART = 1.0 / 1024.0
"""A load step below this fraction of the load is given up."""

SMALLER = 1.0 / 4.0
"""A load step that does not lead to an equilibrium is tried again with this part of it."""

PATIENCE = 60
"""Iterations of load steps after which restrained steps are tried."""


@dataclass(frozen=True, slots=True, eq=False)
class StaticSolution:
    """An equilibrium.

    Attributes:
        state: The state at rest in it; joint efforts are what the drives must hold.
        iterations: Linear solves spent, over all load steps.
        load_steps: Parts in which the load was applied; 1 where Newton's method went straight to the answer.
        residual: Largest unbalanced force on an unknown in [N]; moments are divided by their lever arm.
    """

    state: State
    iterations: int
    load_steps: int
    residual: float


def solve_static(
    model: Model,
    state: State,
    control: Control,
    parameters: Parameters,
    *,
    actuators: Actuators | None = None,
    tolerance: float = 1e-11,
    solver: LinearSolver | None = None,
) -> StaticSolution:
    """The stable equilibrium under a constant control that is reached from `state`.

    Where there are several, it is not always the one that a load which grows slowly leads to.

    Args:
        model: The model.
        state: Where to start; it is not changed. Velocities do not matter; held nodes stay where they are.
        control: Joint targets in [rad] or [m], external node forces in [N], base shift in [m].
        parameters: Material; damping has no part in an equilibrium.
        actuators: What pulls and pushes at the command of joints; contacts have no part in it.
        tolerance: The last Newton step moves nothing by more than this, in [m].
        solver: The linear solver; None: the default.

    Raises:
        NotConvergedError: there is none, none that is stable, or it could not be reached from `state`.
    """
    chosen, acting = solver or linear_solver(), actuators or Actuators()
    with np.errstate(all="ignore"):  # far off, numbers overflow: such steps are refused
        problem = StaticProblem(model, control, parameters, state, acting, chosen)
        try:
            current, steps = problem.newton(problem.start, 1.0, tolerance), 1
        except NotConvergedError:
            part, stable = SMALLER, problem.starts_stable
            found = None if stable else _restrained(problem, problem.start, tolerance)
            if found is None and not stable:
                standing = replace(control, targets=problem.first_targets, base_shift=problem.first_shift)
                first = StaticProblem(model, standing, parameters, state, acting, chosen)
                settled, spent, part = first.let_go(tolerance), problem.iterations + first.iterations, 1.0
                problem = StaticProblem(model, control, parameters, settled, acting, chosen)
                problem.iterations = spent
            current, steps = (found, 1) if found is not None else _in_parts(problem, tolerance, part)
        residual = problem.finish(current)
    return StaticSolution(current, problem.iterations, steps, residual)


def _restrained(problem: StaticProblem, before: State, tolerance: float) -> State | None:
    """The equilibrium under the whole load by restrained steps from a state; None: they lead to none."""
    try:
        return problem.restrained(before, tolerance)
    except (NotConvergedError, np.linalg.LinAlgError):  # the latter of the rotations of elements
        return None


def _in_parts(problem: StaticProblem, tolerance: float, part: float) -> tuple[State, int]:
    """The equilibrium under the whole load, of which a part is tried first, and how many parts it took.

    Where parts take long, restrained steps are tried once in the place of all that are left; not where an
    unstable equilibrium was met: which way a column buckles would depend on round-off.
    """
    current, reached, steps, tried = problem.start, 0.0, 0, False
    soon = problem.iterations + PATIENCE
    while reached < 1.0:
        goal = min(1.0, reached + part)
        try:
            current = problem.newton(current, goal, tolerance)
        except NotConvergedError as failure:
            if problem.iterations > soon and not tried and not problem.met_unstable:
                tried = True
                if (found := _restrained(problem, current, tolerance)) is not None:
                    return found, steps + 1
            part *= SMALLER
            if part < SMALLEST_PART:
                raise failure
            continue
        reached, steps, part = goal, steps + 1, 2.0 * part
    return current, steps
