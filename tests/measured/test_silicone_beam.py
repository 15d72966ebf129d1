"""The beam of scene `silicone_beam` beside the measured one: own weight, and 52 g hung on its free edge.

The constants of the scene were found on these two runs; see docs/materials.md. Times count from the first
minimum: before it, a hand is on the beam.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import curve_fit

from softsim_core import Simulation, load_scene
from softsim_core.base import Array, Box, SceneError
from softsim_core.lab.identification import (
    calibrate,
    data_of,
    load_calibration,
    load_session,
    session_robot,
    validate_session,
)
from softsim_core.scene import AddedMassDescription, SceneDescription

pytestmark = [pytest.mark.slow, pytest.mark.numba]

RUNS = {"gravity": 0.0, "load52": 0.052015}
"""Hung mass in [kg] of the runs."""
MARKERS = {
    "tip_top": ((0.1, 0.0, 0.015), (0.0, 0.0, 0.006)),
    "tip_left": ((0.1, -0.015, 0.009), (0.0, -0.006, 0.0)),
    "tip_right": ((0.1, 0.015, -0.009), (0.0, 0.006, 0.0)),
}
"""Places on the beam at rest, and how far in front of them the markers are, in [m]."""
HEIGHTS = {"gravity": 0.4e-3, "load52": 1.0e-3}
"""Root mean square over 3 s of ringing that is allowed, in [m]."""
UNSEEN = 0.13
"""Part of the measured damping by which the shipped constants miss that of runs they were not found from."""


@dataclass(frozen=True)
class Trace:
    """Heights in [m] of the three markers above where they were held, at times in [s]."""

    times: Array
    heights: dict[str, Array]

    @property
    def first_minimum(self) -> float:
        """Of the left marker, in [s]."""
        z, t = self.heights["tip_left"], self.times
        low = (z[1:-1] < z[:-2]) & (z[1:-1] <= z[2:]) & (t[1:-1] > 0.02) & (z[1:-1] < 0.3 * z.min())
        k = int(np.flatnonzero(low)[0]) + 1
        before, here, after = z[k - 1 : k + 2]
        return float(t[k] + 0.5 * (before - after) / (before - 2.0 * here + after) * (t[1] - t[0]))

    def rest(self, marker: str, end: float) -> float:
        """Its mean in the half second before `end` in [s]."""
        return float(self.heights[marker][(self.times > end - 0.5) & (self.times <= end)].mean())

    def ringing(self, marker: str) -> Array:
        """Heights in steps of 10 ms of the 3 s after the first minimum."""
        return np.interp(self.first_minimum + np.arange(0.0, 3.0, 0.01), self.times, self.heights[marker])

    def swing(self, frequency: float) -> tuple[float, float]:
        """Frequency in [Hz] and damping ratio of the left marker: a damped cosine, and a slow creep."""
        z, t = self.ringing("tip_left"), np.arange(0.0, 3.0, 0.01)

        def model(
            t: Array, rest: float, size: float, f: float, decay: float, phase: float, creep: float
        ) -> Array:
            swing = size * np.exp(-decay * t) * np.cos(2.0 * np.pi * f * t + phase)
            return np.asarray(rest + swing + creep * np.exp(-t / 0.95))

        start = (z[-20:].mean(), z[0] - z[-20:].mean(), frequency, 2.0, 0.0, 0.0)
        _, _, f, decay, _, _ = curve_fit(model, t, z, p0=start, maxfev=20_000)[0]
        return float(abs(f)), float(decay / np.hypot(decay, 2.0 * np.pi * f))


def measured(folder: Path, run: str) -> Trace:
    with (folder / "real" / "data" / f"beam_{run}_V2_a.csv").open() as file:
        lines = [line for line in file if not line.startswith("#")]
    names, rows = (
        lines[0].strip().split(","),
        np.array([list(map(float, line.split(","))) for line in lines[1:]]),
    )
    times = rows[:, 0]
    columns = {marker: rows[:, names.index(f"{marker}_z_m")] for marker in MARKERS}
    return Trace(times, {marker: z - z[times <= 0.0].mean() for marker, z in columns.items()})


def beam(mass: float) -> SceneDescription:
    """The shipped scene with a mass on the upper edge of its free end."""
    scene = load_scene("silicone_beam").scene
    if not mass:
        return scene
    edge = Box(center=(0.1, 0.0, 0.015), size=(1e-4, 1.0, 1e-4))
    (body,) = scene.bodies
    return replace(scene, bodies=(replace(body, added_masses=(AddedMassDescription(mass=mass, box=edge),)),))


@cache
def simulated(run: str) -> Trace:
    simulation = Simulation(beam(RUNS[run]))
    rest = simulation.positions.copy()
    (tip,) = np.nonzero(np.abs(rest[:, 0] - 0.1) < 1e-9)
    rows = [dict.fromkeys(MARKERS, 0.0)]
    for _ in range(500):
        simulation.step()
        rows.append(markers(rest[tip], simulation.positions[tip]))
    times = simulation.dt * np.arange(len(rows))
    return Trace(times, {marker: np.array([row[marker] for row in rows]) for marker in MARKERS})


def markers(rest: Array, places: Array) -> dict[str, float]:
    """How far the markers have risen, by the nodes of the free end: a biquadratic surface that turns."""
    centred, moved = rest - rest.mean(axis=0), places - places.mean(axis=0)
    u, _, vt = np.linalg.svd(centred.T @ moved)
    turn = (u @ vt).T
    result = {}
    for marker, (place, ahead) in MARKERS.items():
        y, z = (rest - place).T[1:]
        terms = np.stack([y**i * z**j for i in range(3) for j in range(3)], axis=1)
        moves = np.linalg.lstsq(terms, places - rest, rcond=None)[0][0]
        result[marker] = float((moves + turn @ ahead - ahead)[2])
    return result


@pytest.mark.parametrize("run", RUNS)
def test_it_comes_to_rest_where_the_measured_one_does(reference_dir: Path, run: str) -> None:
    ours, theirs = simulated(run), measured(reference_dir, run)
    end = min(5.0, float(theirs.times[-1]))
    both = np.array([(ours.rest(marker, end), theirs.rest(marker, end)) for marker in MARKERS])
    apart, sunk = np.abs(np.diff(both.mean(axis=0)))[0], abs(both[:, 1].mean())
    assert apart < max(0.05 * sunk, 0.5e-3), both


@pytest.mark.parametrize(("run", "frequency"), [("gravity", 7.7), ("load52", 4.3)])
def test_it_rings_as_fast_and_as_long(reference_dir: Path, run: str, frequency: float) -> None:
    ours, theirs = simulated(run).swing(frequency), measured(reference_dir, run).swing(frequency)
    assert ours[0] == pytest.approx(theirs[0], rel=0.02)
    assert ours[1] == pytest.approx(theirs[1], rel=0.15)


@pytest.mark.parametrize("run", RUNS)
def test_three_seconds_of_ringing_are_alike(reference_dir: Path, run: str) -> None:
    ours, theirs = simulated(run), measured(reference_dir, run)
    for marker in MARKERS:
        off = ours.ringing(marker) - theirs.ringing(marker)
        assert np.sqrt((off**2).mean()) < HEIGHTS[run], marker


@pytest.mark.exhaustive
@pytest.mark.parametrize("fitted", [(), *((run,) for run in RUNS)], ids=["both", *RUNS])
def test_calibration_finds_the_damping_of_runs_it_has_not_seen(
    reference_dir: Path, fitted: tuple[str, ...]
) -> None:
    """From one run the damping of the other, and from both that of each; three markers."""
    description, file = load_calibration("silicone_beam")
    data = data_of(description, file, reference_dir / "real" / "data")
    found = calibrate(replace(description, sessions=fitted), data)
    misses = {}
    for session in data.description.sessions:
        robot = session_robot(data.robot, session, found.overlay)
        rings = validate_session(load_session(data, session), robot).ringings()
        assert len(rings) == len(MARKERS)
        misses[session.name] = {
            name: model.damping / measured.damping - 1.0 for name, (measured, model) in rings.items()
        }
    for name, each in misses.items():
        shown = ", ".join(f"{marker} {100.0 * miss:+.1f} %" for marker, miss in each.items())
        print(f"damping of {name}, fitted to {' and '.join(fitted) or 'both'}: {shown}")
    assert max(abs(miss) for each in misses.values() for miss in each.values()) < UNSEEN


def test_a_mass_where_no_node_is_is_refused() -> None:
    scene = load_scene("silicone_beam").scene
    (body,) = scene.bodies
    beside = AddedMassDescription(mass=0.05, box=Box(center=(0.2, 0.0, 0.0), size=(0.01, 0.01, 0.01)))
    with pytest.raises(SceneError, match="no node of it lies inside the region of an added mass"):
        Simulation(replace(scene, bodies=(replace(body, added_masses=(beside,)),)))
