"""Measure a rod that falls on its clamp: error over cost, beside PyElastica.

A rod of 200 mm and 10 mm diameter (1 MPa, 1000 kg/m^3) is clamped at one end, horizontal, and falls. The
error is the distance of its free end from that of a converged motion, rms over 0.4 s.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Any, Final

import numpy as np

from benchmarks.records import align_columns
from softsim_core import Simulation
from softsim_core.base import Array, Contender, Sphere, install_command, take_turns, version_of
from softsim_core.scene import (
    AttachmentDescription,
    BodyDescription,
    MaterialDescription,
    RodDescription,
    RodSectionDescription,
    SceneDescription,
    SolverSettings,
)

LENGTH, RADIUS, YOUNG, POISSON, DENSITY, GRAVITY = 0.2, 0.005, 1.0e6, 0.3, 1000.0, 9.81
SECONDS, SAMPLE = 0.4, 1.0e-3
"""Simulated time, and time between two positions of the reference, both in [s]."""
COUNTS: Final = (50, 10)
"""Numbers of elements; with the first one PyElastica is compared."""
ROUNDS: Final = 5
SCHEMES: Final[dict[str, dict[str, Any]]] = {
    "Euler": {},
    "Bossak": {"time_integration": "bossak"},
    "Bossak, iterated": {"time_integration": "bossak", "iterations": 10},
}
STEPS_MS: Final = (0.5, 1.0, 2.0, 5.0, 8.0, 10.0)
REFERENCE: Final = {
    "time_integration": "bossak", "spectral_radius": 1.0, "iterations": 20, "iteration_tolerance": 1e-10,
}  # fmt: skip
REFERENCE_MS: Final = 0.25
PEER: Final = "PyElastica"
PEER_DT: Final = 95.0e-6
"""Step of PyElastica in [s] with 50 elements; with 100 us it is about to be unstable."""
PEER_ELEMENTS: Final = (50, 100, 200)
EQUAL: Final = 1.0
"""Error in [mm] at which speeds are compared."""
LIMIT: Final = 3.0
"""Least speed of the fastest run with at most that error, in speeds of PyElastica with as many elements."""


@dataclass
class Fall:
    """One way to compute the fall.

    Attributes:
        scheme: One of SCHEMES, or PEER.
        elements: Number of elements.
        dt: Step in [s].
        begin: Makes a new rod and returns a function that computes positions of its free end, (n, 3), at n
            times that are SECONDS / n apart.
        error: Rms error in [mm].
        shortest, median: Time of a run in [s].
    """

    scheme: str
    elements: int
    dt: float
    begin: Callable[[], Callable[[], Array]]
    error: float = np.nan
    shortest: float = np.nan
    median: float = np.nan

    def contend(self, name: str) -> Contender:
        """Return the run to be timed, without the making of the rod."""
        made: list[Callable[[], Array]] = []
        return Contender(name, lambda: made.pop()(), prepare=lambda: made.append(self.begin()))

    @property
    def speed(self) -> float:
        """Simulated seconds per second, of the shortest run."""
        return SECONDS / self.shortest

    def as_json(self) -> dict[str, object]:
        """Return the measurement as a JSON object."""
        return {
            "scheme": self.scheme, "elements": self.elements, "dt_s": self.dt, "rms_error_mm": self.error,
            "shortest_s": self.shortest, "median_s": self.median, "speed": self.speed,
        }  # fmt: skip


def fall(elements: int, dt: float, settings: dict[str, Any]) -> Callable[[], Array]:
    """Make a rod; return a function that computes the positions of its free end after each step, (n, 3)."""
    rod = RodDescription(
        centreline=((0.0, 0.0, 0.0), (LENGTH, 0.0, 0.0)),
        section=RodSectionDescription(shape="ellipse", size=(2.0 * RADIUS, 2.0 * RADIUS)),
        elements=elements,
    )
    material = MaterialDescription(law="rod", young_modulus=YOUNG, poisson_ratio=POISSON)
    clamp = AttachmentDescription(
        name="clamp", body="rod", to="world", sphere=Sphere(center=(0.0, 0.0, 0.0), radius=1e-6)
    )
    simulation = Simulation(
        SceneDescription(
            name="rod",
            dt=dt,
            gravity=(0.0, 0.0, -GRAVITY),
            bodies=(BodyDescription(name="rod", rod=rod, material=material, density=DENSITY),),
            attachments=(clamp,),
            solver=SolverSettings(**settings),
        )
    )

    def run() -> Array:
        ends = np.empty((round(SECONDS / dt), 3))
        for k in range(len(ends)):
            simulation.step()
            ends[k] = simulation.positions[-3:].mean(axis=0)
        return ends

    return run


def fall_of_peer(elements: int, dt: float) -> Callable[[], Array]:
    """Make a rod of PyElastica; return a function that computes its free end every SAMPLE, (n, 3)."""
    elastica: Any = import_module("elastica")

    class Collection(elastica.BaseSystemCollection, elastica.Constraints, elastica.Forcing):
        pass

    systems = Collection()
    rod = elastica.CosseratRod.straight_rod(
        elements, np.zeros(3), np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]), LENGTH, RADIUS, DENSITY,
        youngs_modulus=YOUNG, shear_modulus=YOUNG / (2.0 * (1.0 + POISSON)),
    )  # fmt: skip
    systems.append(rod)
    start = {"constrained_position_idx": (0,), "constrained_director_idx": (0,)}
    systems.constrain(rod).using(elastica.OneEndFixedBC, **start)
    systems.add_forcing_to(rod).using(elastica.GravityForces, acc_gravity=np.array([0.0, 0.0, -GRAVITY]))
    systems.finalize()
    stepper, parts = elastica.PositionVerlet(), int(np.ceil(SAMPLE / dt))

    def run() -> Array:
        ends, time = np.empty((round(SECONDS / SAMPLE), 3)), 0.0
        for k in range(len(ends)):
            for _ in range(parts):
                time = stepper.step(systems, time, SAMPLE / parts)
            ends[k] = rod.position_collection[:, -1]
        return ends

    return run


def rms_error(ends: Array, reference: Array) -> float:
    """Return the rms distance in [mm] of two motions (n, 3) at the times that both have."""
    n = np.gcd(len(ends), len(reference))
    a, b = (each[len(each) // n - 1 :: len(each) // n] for each in (ends, reference))
    return float(1e3 * np.sqrt(np.square(a - b).sum(axis=1).mean()))


def peer_missing() -> str | None:
    """Return why PyElastica is not measured; None if it is installed."""
    if version_of("pyelastica"):
        return None
    return f"{PEER} is not measured: it is not installed; {install_command('peers')}"


def measure_rods(peer: bool) -> tuple[list[Fall], list[str]]:
    """Compute the fall in turns; return measurements and notes.

    Args:
        peer: Whether PyElastica takes part.
    """
    reference = fall(COUNTS[0], 1e-3 * REFERENCE_MS, REFERENCE)()
    falls = [
        Fall(scheme, elements, 1e-3 * ms, partial(fall, elements, 1e-3 * ms, settings))
        for elements, steps in zip(COUNTS, (STEPS_MS, STEPS_MS[-3:]), strict=True)
        for scheme, settings in SCHEMES.items()
        for ms in steps
    ]
    notes = []
    if peer:
        falls += [
            Fall(PEER, n, PEER_DT * COUNTS[0] / n, partial(fall_of_peer, n, PEER_DT * COUNTS[0] / n))
            for n in PEER_ELEMENTS
        ]
        coarse, fine = (fall_of_peer(n, PEER_DT * COUNTS[0] / n)() for n in PEER_ELEMENTS[-2:])
        limit = 2.0 * fine - coarse  # its error halves with the elements
        notes.append(
            f"{PEER}, extrapolated from {PEER_ELEMENTS[-2]} and {PEER_ELEMENTS[-1]} elements, ends within "
            f"{rms_error(limit, reference):.2f} mm rms of the reference"
        )
        own = fall_of_peer(COUNTS[0], PEER_DT / 8.0)()
        notes.append(
            f"{PEER}'s steps alone, beside eighths of them: "
            f"{1e3 * rms_error(fall_of_peer(COUNTS[0], PEER_DT)(), own):.2f} um"
        )
    for each in falls:
        each.error = rms_error(each.begin()(), reference)
    times = take_turns([each.contend(f"{k}") for k, each in enumerate(falls)], ROUNDS)
    for k, each in enumerate(falls):
        each.shortest, each.median = 1e-3 * float(times[f"{k}"].min()), 1e-3 * float(np.median(times[f"{k}"]))
    return falls, notes


def speed_ratio(falls: Sequence[Fall], elements: int) -> float:
    """Return the speed at an error of at most EQUAL, in speeds of PyElastica with COUNTS[0] elements.

    Args:
        falls: The measurements.
        elements: Number of elements of the rods that are looked at.
    """
    beside = [each.speed for each in falls if (each.scheme, each.elements) == (PEER, COUNTS[0])]
    ours = [
        each.speed
        for each in falls
        if each.scheme != PEER and each.elements == elements and each.error <= EQUAL
    ]
    return max(ours, default=0.0) / beside[0] if beside else np.nan


def rod_table(falls: Sequence[Fall]) -> list[str]:
    """Return the lines of a table."""
    rows: list[tuple[str, ...]] = [
        ("scheme", "elements", "dt ms", "rms error mm", "s per s, of the shortest run", "of the median")
    ]
    rows += [
        (
            each.scheme, f"{each.elements}", f"{1e3 * each.dt:.3g}", f"{each.error:.3g}",
            f"{each.speed:.3g}", f"{SECONDS / each.median:.3g}",
        )
        for each in falls
    ]  # fmt: skip
    return align_columns(rows)
