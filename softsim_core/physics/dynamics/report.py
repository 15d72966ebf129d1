"""Report of a step: its contacts, its iterations, and the time of each of its stages."""

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
"""Enclosing stage of each stage; any other stage is at the top level."""


@dataclass(frozen=True, slots=True)
class StageShare:
    """A stage in the tree of stages.

    Attributes:
        name: Name of the stage.
        level: Number of enclosing stages.
        total: Time of the stage, in the unit it was given in.
        own: Time of the stage without its parts, >= 0.
    """

    name: str
    level: int
    total: float
    own: float


def stage_tree(times: Mapping[str, float]) -> list[StageShare]:
    """Return the stages in tree order: each before its parts, siblings in the order given.

    Args:
        times: Time of each stage by its name, all in one unit; a part without its whole is at the top level.
    """
    return [share for name in times if PART_OF.get(name) not in times for share in _branch(name, 0, times)]


def _branch(name: str, level: int, times: Mapping[str, float]) -> Iterator[StageShare]:
    parts = [part for part in times if PART_OF.get(part) == name]
    yield StageShare(name, level, times[name], max(0.0, times[name] - sum(times[part] for part in parts)))
    for part in parts:
        yield from _branch(part, level + 1, times)


@dataclass(frozen=True, slots=True, eq=False)
class ContactReport:
    """Contacts of the last step, and pairs closer than the contact margin, with zero forces.

    If the step was cut into parts, a contact of several parts is listed once for each. Its forces are
    weighted by the duration of the part, so that their sum is the mean over time; points and gaps are those
    at the end of the part.

    Attributes:
        points: Midpoint of each contact in [m], shape (k, 3).
        forces: Force on the first surface of each pair in [N], world axes, shape (k, 3).
        normals: Unit vectors from the second surface of each pair to the first, shape (k, 3).
        gaps: Gap between the true shapes at the end of the step, beyond the contact distance, in [m], shape
            (k,): between a vertex (or sphere) and the nearest point of the other surface, or between two
            edges; where surfaces overlap, minus the depth. The smallest is the smallest gap of all surfaces
            that may meet.
        pairs: Numbers of the two surfaces, as in `Simulation.collision_surfaces`, shape (k, 2).
        bodies: Numbers of their bodies, as in `body_names`, shape (k, 2).
        body_names: Names of all bodies of the scene.
        vertices: Collision vertices of each contact, three of each surface, shape (k, 6).
        weights: Shares of these vertices in the force, which add up to 1 for each surface, shape (k, 6).
        residual: Violation of the contact law by the forces, in [m].
        sweeps: Number of sweeps of the contact solver.
        passes: Number of times that the contacts were linearised and solved.
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
    """Return the report of a step without contacts."""
    return NOTHING


def mean_contacts(parts: Sequence[tuple[float, ContactReport]]) -> ContactReport:
    """Return the contacts of a step that was cut into parts, each with its share of the force.

    Args:
        parts: Share of dt and contacts of each part, in order.
    """
    pressed = [report.forces.any(axis=1) for _, report in parts]
    pressed[-1][:] = True  # pairs without force are those of the end
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


def skip_dilation() -> float:
    """Return the dilation of a step in which rotations cause no strain, 0."""
    return 0.0


def unknown() -> float:
    """Return the error of a step for which it is unknown, NaN in [m]."""
    return math.nan


@dataclass(eq=False)
class StepReport:
    """Report of a step; it is complete once the step is done.

    Attributes:
        top_speed: Largest component in [m/s] of the new velocities of free nodes, frames, sliding joints and
            rigid bodies, for the latter also the spin times the radius of gyration; NaN if any velocity is
            NaN.
        times: Time of each stage in [ms]; see `PART_OF`.
        inverted: Number of elements that are inverted or flat at the end of the step (det F <= 0).
        positive: Whether the factorisation found the matrix of the step positive definite.
        linear_iterations: Conjugate gradient iterations for all right-hand sides; 0: the matrix was factored.
        parts: Number of parts that the step was cut into; see dynamics.substeps.
        iterations: Number of Newton iterations; see dynamics.iterations.
        fallback: Part of the planned matrix that was left out to make it positive definite: 0 nothing, 1 the
            stiffness of the surfaces that actuators press on, 2 also all negative parts of cells and the
            stress that the last linear solve found. It is 0 in scenes whose steps never include these.
        measure: Measures the contacts at the end of the step.
        estimate: Computes `linearisation_error`.
        dilate: Computes `dilation`.
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
    dilate: Callable[[], float] = skip_dilation

    @cached_property
    def contacts(self) -> ContactReport:
        """Contacts of the step; measured on first access."""
        return self.measure()

    @cached_property
    def linearisation_error(self) -> float:
        """Largest node displacement in [m] of another Newton iteration.

        It is about the error of the step against the nonlinear one, as long as iterations converge quickly;
        the error of the time discretisation is not included. The first access costs one iteration and changes
        nothing: read it before forces, parameters or the state change. For a step that was cut, it is that of
        the last part. NaN: unknown, or another step has begun.
        """
        return self.estimate()

    @cached_property
    def dilation(self) -> float:
        """Strain by which the step stretches a rotating body only because it is linearised once.

        It is about omega^2 dt (dt + rayleigh_stiffness) / 2 for a body that rotates at omega [rad/s], the
        largest of all bodies with fixed nodes or a law without potential. It is 0 for other bodies, and in
        steps of two or more iterations; see dynamics.iterations.FreeTurning. Like `linearisation_error`, it
        is computed on first access, and is that of the last part of a step that was cut.
        """
        return self.dilate()
