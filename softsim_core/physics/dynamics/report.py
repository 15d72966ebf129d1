"""The report of a step: its contacts, its iterations, and the time of each of its stages."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final

import numpy as np

from softsim_core.base import Array, IndexArray

PART_OF: Final = {
    "controllers": "step",
    "assemble": "step",
    "factor": "step",
    "iterate": "step",
    "solve": "step",
    "update": "step",
    "sensors": "step",
    "detect": "step",
    "contact": "step",
    "compliance": "contact",
    "forces": "contact",
    "correct": "contact",
}
"""The stage that each is a part of; any other stands on its own."""


@dataclass(frozen=True, slots=True)
class StageShare:
    """A stage in the tree.

    Attributes:
        name: Name of the stage.
        level: How many stages it is inside.
        total: Its time, in the unit it was given in.
        own: Its time without that of its parts, >= 0.
    """

    name: str
    level: int
    total: float
    own: float


def stage_tree(times: Mapping[str, float]) -> list[StageShare]:
    """Stages in the order of a tree: each before its parts, parts and wholes in the order given.

    Args:
        times: Time of each stage by its name, all in one unit; a part whose whole is missing is one itself.
    """
    return [share for name in times if PART_OF.get(name) not in times for share in _branch(name, 0, times)]


def _branch(name: str, level: int, times: Mapping[str, float]) -> Iterator[StageShare]:
    parts = [part for part in times if PART_OF.get(part) == name]
    yield StageShare(name, level, times[name], max(0.0, times[name] - sum(times[part] for part in parts)))
    for part in parts:
        yield from _branch(part, level + 1, times)


@dataclass(frozen=True, slots=True, eq=False)
class ContactReport:
    """What touched in the last step, and what else came closer than the contact margin, with forces of zero.

    Of a step that was cut in parts, what touched in several of them is here once for each: forces are shares,
    so that their sum is the mean in time, and points and gaps are those at the end of the part.

    Attributes:
        points: Middle of each contact in [m], shape (k, 3).
        forces: Force on the first surface of each pair in [N], world axes, shape (k, 3).
        normals: Unit vectors from the second surface of each pair to the first, shape (k, 3).
        gaps: Gap between the true shapes at the end of the step, beyond the contact distance, in [m], shape
            (k,): between a vertex (or sphere) and the nearest place of the other surface, or between two
            edges; where surfaces overlap, minus the depth. The smallest is the smallest gap of all surfaces
            that may meet.
        pairs: Numbers of the two surfaces, as in `Simulation.collision_surfaces`, shape (k, 2).
        bodies: Numbers of their bodies, as in `body_names`, shape (k, 2).
        body_names: Names of all bodies of the scene.
        vertices: Collision vertices that carry each contact, three of either surface, shape (k, 6).
        weights: Their shares in its force, those of either surface add up to 1, shape (k, 6).
        residual: How far the forces are from the contact law, in [m].
        sweeps: Sweeps of the contact solver.
        passes: How often the contacts were linearised and solved.
    """

    points: Array
    forces: Array
    normals: Array
    gaps: Array
    pairs: IndexArray
    bodies: IndexArray
    body_names: tuple[str, ...]
    vertices: IndexArray
    weights: Array
    residual: float
    sweeps: int
    passes: int


_NO_VECTORS, _NO_PAIRS = np.zeros((0, 3)), np.zeros((0, 2), np.int64)
NOTHING = ContactReport(
    points=_NO_VECTORS,
    forces=_NO_VECTORS,
    normals=_NO_VECTORS,
    gaps=np.zeros(0),
    pairs=_NO_PAIRS,
    bodies=_NO_PAIRS,
    body_names=(),
    vertices=np.zeros((0, 6), np.int64),
    weights=np.zeros((0, 6)),
    residual=0.0,
    sweeps=0,
    passes=0,
)


def nothing() -> ContactReport:
    """The report where nothing touched."""
    return NOTHING


def mean_contacts(parts: Sequence[tuple[float, ContactReport]]) -> ContactReport:
    """The contacts of a step that was cut in parts: those of each, with its share of the force.

    Args:
        parts: Share of dt of each part, and what touched in it, in order.
    """
    pressed = [report.forces.any(axis=1) for _, report in parts]
    pressed[-1][:] = True  # what came near only is that of the end
    shown = [(share, report, own) for (share, report), own in zip(parts, pressed, strict=True) if own.any()]
    if not shown:
        return parts[-1][1]
    reports = [report for _, report, _ in shown]
    joined: dict[str, Any] = {
        name: np.concatenate([getattr(report, name)[own] for _, report, own in shown])
        for name in ("points", "normals", "gaps", "pairs", "bodies", "vertices", "weights")
    }
    return replace(
        reports[-1],
        **joined,
        forces=np.concatenate([share * report.forces[own] for share, report, own in shown]),
        residual=max(report.residual for report in reports),
        sweeps=sum(report.sweeps for report in reports),
        passes=sum(report.passes for report in reports),
    )


def undilated() -> float:
    """The dilation of a step that takes no turning for a strain."""
    return 0.0


def unknown() -> float:
    """The error of a step that nobody can tell, in [m]."""
    return math.nan


@dataclass(eq=False)
class StepReport:
    """What a step tells; it is complete once the step is done.

    Attributes:
        top_speed: Largest component in [m/s] of the new velocities of free nodes, frames, slides and rigid
            bodies, of these also the spin times the radius of gyration; NaN if any velocity is one.
        times: Time of each stage in [ms]; see dynamics.stages.
        inverted: Number of elements that are inside out or flat at the end of the step (det F <= 0).
        positive: Whether the factorisation found the matrix of the step positive definite.
        linear_iterations: Of conjugate gradients, all right-hand sides together; 0: the matrix was factored.
        parts: Equal or unequal parts that the step was done in; see dynamics.substeps.
        iterations: Newton iterations that it took; see dynamics.iterations.
        fallback: How much of the planned matrix was left out until one was positive definite: 0 nothing, 1
            the stiffness of what actuators press on, 2 all that is negative in a cell, too, and the stress
            that the last linear solve found. Scenes that always step so have none.
        measure: Measures what touched, where everything was at the end of the step.
        estimate: Finds `linearisation_error`.
        dilate: Finds `dilation`.
    """

    top_speed: float = 0.0
    times: Mapping[str, float] = field(default_factory=dict)
    inverted: int = 0
    positive: bool = True
    linear_iterations: int = 0
    parts: int = 1
    iterations: int = 1
    fallback: int = 0
    measure: Callable[[], ContactReport] = nothing
    estimate: Callable[[], float] = unknown
    dilate: Callable[[], float] = undilated

    @cached_property
    def contacts(self) -> ContactReport:
        """What touched; measured when it is first asked for."""
        return self.measure()

    @cached_property
    def linearisation_error(self) -> float:
        """How far in [m] another Newton iteration would move a node at most.

        About what the step is off the one that is not linearised, for as long as iterations converge quickly;
        the error of stepping in time at all is no part of it. It costs one iteration when it is first asked
        for, and nothing else: ask before forces, parameters or the state change. Of a step that was cut, it
        is that of the last part. NaN: nobody knows, or another step has begun.
        """
        return self.estimate()

    @cached_property
    def dilation(self) -> float:
        """Strain by which the step stretches a turning body only because it is linearised once.

        About omega^2 dt (dt + rayleigh_stiffness) / 2 for a body that turns at omega [rad/s], the largest of
        all: of bodies that something holds, or whose law has no potential. 0 for others, and in steps of two
        iterations or more; see dynamics.free_turning. As `linearisation_error` it is found when it is first
        asked for, and is that of the last part of a step that was cut.
        """
        return self.dilate()
