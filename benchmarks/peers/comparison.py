"""Compare our step with the other engines' on the same clamped body in one run, and the sag of each."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks import FALL_STEPS, STEPS_A_TURN, Case, Record, known_paths
from benchmarks.peers.body import ClampedBody, Engine, PeerMissingError, clamped_body
from benchmarks.peers.drake_body import DrakeBody
from softsim_core import Simulation
from softsim_core.base import Array, Contender, MjcfError, restart_every, take_turns
from softsim_core.mjcf import ITERATIONS, MujocoRun, export_mjcf
from softsim_core.scene import RobotDescription

SETTLING_S = 3.0
"""Simulated time after which the undamped body rests: implicit Euler steps of 0.01 s damp it."""

STEPS_A_TURN_OF_PEERS = 2

DEFAULT_ITERATIONS = 100
"""MuJoCo's own limit; it warns that the clamped body's solve has not converged within it."""


class MujocoFlex(MujocoRun):
    """The clamped body in MuJoCo, written as a flex by our own MJCF export.

    Args:
        body: What to simulate.
        iterations: Maximum number of iterations of a step's solve.

    Raises:
        PeerMissingError: MuJoCo is not installed or has no integrator `discrete`.
    """

    def __init__(self, body: ClampedBody, iterations: int = ITERATIONS) -> None:
        try:
            super().__init__(export_mjcf(body.scene, iterations).text)
        except MjcfError as error:
            raise PeerMissingError(f"MuJoCo is not measured: {error.reason}") from error
        self.name = "mujoco" if iterations > DEFAULT_ITERATIONS else "mujoco_unconverged"


ENGINES: tuple[Callable[[ClampedBody], Engine], ...] = (
    DrakeBody,
    partial(DrakeBody, clamped=False),
    MujocoFlex,
    partial(MujocoFlex, iterations=DEFAULT_ITERATIONS),
)


class OurBody:
    """The clamped body in our own step, as a user runs it; compiled where Numba is installed."""

    version = ""
    rests = True
    method = "corotational linear tetrahedra, one exact factorisation a step"

    def __init__(self, description: RobotDescription) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            self._simulation = Simulation(description, backend=known_paths()[0])
        self.name = self._simulation.backend

    def restart(self) -> None:
        """Return to the rest shape with zero velocity."""
        self._simulation.reset()

    def advance(self) -> None:
        """Advance by one step of dt."""
        self._simulation.step()

    def points(self) -> Array:
        """Return the current node positions in [m], shape (n, 3), in the order of ClampedBody.points."""
        return self._simulation.positions


def compare(case: Case, rounds: int, to_rest: bool = True) -> tuple[list[Record], list[str]]:
    """Measure the clamped body of a case in our step and in every installed engine.

    Args:
        case: A case with a scene that is clamped in one box.
        rounds: Turns of each engine.
        to_rest: Whether to simulate until the body rests, to measure its sag.

    Returns:
        Records of the other engines, with our own figures in `ours_min_ms` and `ours_sag_mm`; and one message
        for each engine that is missing.
    """
    body = clamped_body(case.description)
    engines: list[Engine] = []
    missing: list[str] = []
    for make in ENGINES:
        try:
            engines.append(make(body))
        except PeerMissingError as error:
            missing.append(str(error))
    if not engines:
        return [], list(dict.fromkeys(missing))
    ours = OurBody(case.description)
    calls = [STEPS_A_TURN[known_paths()[0]], *[STEPS_A_TURN_OF_PEERS] * len(engines)]
    contenders = [
        Contender(each.name, each.advance, steps, restart_every(max(1, FALL_STEPS // steps), each.restart))
        for each, steps in zip((ours, *engines), calls, strict=True)
    ]
    times = take_turns(contenders, rounds)
    resting = [each for each in (ours, *engines) if each.rests and to_rest]
    for engine in resting:
        for _ in range(round(SETTLING_S / body.dt)):
            engine.advance()
    fastest = float(times[ours.name].min())
    return [
        Record(
            scene=case.scene,
            mesh=case.mesh,
            path=engine.name,
            nodes=len(body.points),
            elements=len(body.tets),
            min_ms=float(times[engine.name].min()),
            median_ms=float(np.median(times[engine.name])),
            extras={
                "sag_mm": 1e3 * body.sag(engine.points()) if engine in resting else None,
                "ours_sag_mm": 1e3 * body.sag(ours.points()) if to_rest else None,
                "ours_min_ms": fastest,
                "ours_median_ms": float(np.median(times[ours.name])),
                "dt_s": body.dt,
                "version": engine.version,
                "method": engine.method,
                "samples": len(times[engine.name]),
            },
        )
        for engine in engines
    ], list(dict.fromkeys(missing))
