"""Which way a model's free nodes are eliminated, and the plan of it."""

from __future__ import annotations

from softsim_core.actuation.actuators import Actuators
from softsim_core.arrays import IndexArray
from softsim_core.dynamics.numba_backend.direct import DirectElimination, DividedElimination
from softsim_core.dynamics.numba_backend.elimination import Elimination
from softsim_core.dynamics.numba_backend.iterative import IterativeElimination
from softsim_core.dynamics.numba_backend.prepare import prepare
from softsim_core.linalg.division import Division, divided, with_room_for
from softsim_core.linalg.elimination import factor_cost, graph_of
from softsim_core.linalg.matrix_layout import matrix_layout
from softsim_core.linalg.ordering import elimination_order
from softsim_core.linalg.simd import LANES, ROWS
from softsim_core.linalg.symbolic import Plan, plan
from softsim_core.mechanics.model import Model

MANY = 2000
"""Free nodes above which iterations are thought of: with fewer, a factor stays in the cache."""

CROSSING = 250.0
"""Flops for each number of a factor above which reading it ten times is faster than renewing it.

Measured with some 25 Gflop/s, 10 GB/s and eight iterations per step.
"""


TOUCHING = 30
"""Solutions that a step takes besides where bodies touch: its contacts are found in ten rounds of three."""


def planned_elimination(
    model: Model, actuators: Actuators, iterative: bool | None, touching: bool, threads: int
) -> Elimination:
    """A factor or iteration for a model; `iterative` None: what is faster, knowing whether bodies touch."""
    iterations: list[tuple[Plan, Plan]] = []
    divisions: list[Division] = []

    def shared(layout: Plan) -> Plan:
        divisions.append(divided(layout))
        return with_room_for(layout, divisions[0], ROWS) if len(divisions[0].above) else layout

    def lay_out(count: int, edges: IndexArray, beside: IndexArray, reduced_size: int) -> Plan:
        graph = graph_of(count, edges)
        order = elimination_order(graph)
        chosen = iterative
        if chosen is None:
            flops, numbers = factor_cost(graph, order) if count > MANY else (0.0, 0.0)
            solutions = reduced_size + 1 + touching * TOUCHING
            chosen = flops > CROSSING * numbers * solutions
        if not chosen:
            return shared(plan(count, edges, beside, reduced_size, LANES, ROWS, order))
        preconditioner = shared(plan(count, edges, edges[:0], 0, LANES, ROWS, order))
        matrix = matrix_layout(preconditioner.position, edges, beside, reduced_size, LANES)
        iterations.append((matrix, preconditioner))
        return matrix

    prepared = prepare(model, actuators, lay_out)
    division = divisions[0]
    if not len(division.above):
        threads = 1
    if iterations:
        return IterativeElimination(model, actuators, prepared, *iterations[0], division, threads)
    if len(division.above):
        return DividedElimination(model, actuators, prepared, division, threads)
    return DirectElimination(model, actuators, prepared)
