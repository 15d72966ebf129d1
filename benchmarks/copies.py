"""Measure steps per second of many copies of a scene, and of the environments that run them."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from time import perf_counter

import numpy as np

from benchmarks.measured_scenes import TOUCHING, TouchingScene, describe
from benchmarks.peers import clamped_body
from benchmarks.records import align_columns
from softsim_core import Batch, Simulation
from softsim_core.base import MjcfError, install_command, no_garbage_collection
from softsim_core.mjcf import MujocoRun, export_mjcf
from softsim_core.scene import RobotDescription

LIMIT = 0.10
"""Largest fraction of the time outside the physics at 64 copies."""
ACTIONS = 5
"""Number of actions per turn."""


@dataclass(frozen=True)
class EnvironmentCost:
    """One environment with several robots.

    Attributes:
        environment: Its id.
        copies: Number of robots.
        rate: Actions of all robots per second in the best turn.
        overhead: Fraction of that turn's time outside Batch.step, [-].
    """

    environment: str
    copies: int
    rate: float
    overhead: float

    @property
    def missed(self) -> bool:
        """Whether the overhead reaches the limit."""
        return self.overhead >= LIMIT

    @property
    def report_line(self) -> str:
        """Message about the missed target."""
        return f"{self.environment}: {100.0 * self.overhead:.1f} % outside the physics, target < {LIMIT:.0%}"

    def as_json(self) -> dict[str, object]:
        """Return the measurement as a JSON object."""
        return asdict(self)


def measure_environments(copies: int, rounds: int) -> list[EnvironmentCost]:
    """Measure all environments with that many robots on one core.

    Raises:
        ImportError: Gymnasium is not installed.
    """
    from softsim_core.lab.learning import TASKS, RobotVectorEnv

    costs = []
    for name in TASKS:
        robots = RobotVectorEnv(name, copies)
        batch, spent = robots.episodes.batch, [0.0]
        physics = batch.step

        def step_timed(steps: int = 1, chosen: Sequence[int] | None = None) -> list[int]:
            started = perf_counter()
            failed = physics(steps, chosen)  # noqa: B023 (called within this turn of the loop only)
            spent[0] += perf_counter() - started  # noqa: B023
            return failed

        batch.step = step_timed  # type: ignore[method-assign, assignment]
        robots.reset(seed=0)
        still = np.zeros(robots.action_space.shape or (), dtype=np.float32)
        best, share = 0.0, 1.0
        with no_garbage_collection():
            for _ in range(rounds):
                spent[0], started = 0.0, perf_counter()
                for _ in range(ACTIONS):
                    robots.step(still)
                taken = perf_counter() - started
                if copies * ACTIONS / taken > best:
                    best, share = copies * ACTIONS / taken, 1.0 - spent[0] / taken
        costs.append(EnvironmentCost(f"softsim/{name}", copies, best, share))
        robots.close()
    return costs


def cost_table(costs: Sequence[EnvironmentCost]) -> list[str]:
    """Return the costs as lines of aligned columns, head first."""
    rows = [
        (each.environment, str(each.copies), f"{each.rate:.0f}", f"{100.0 * each.overhead:.1f} %")
        for each in costs
    ]
    return align_columns([("environment", "copies", "actions/s", "overhead"), *rows])


MEASURED = (("tripod", "low"), ("tripod", "mid"), ("gripper_grasp", "low"))
"""Measured scenes and meshes."""
PEERS = (("held_centre", "low"), ("held_centre", "mid"))
"""Scenes for MuJoCo: the Tripod's silicone, clamped, without joints."""
COUNTS, QUICK_COUNTS = (1, 2, 8, 64, 256), (1, 8)
WORKERS = (1, 2)
SAMPLE_S = 0.25
"""Approximate duration of one sample in [s]."""
COLD, LEAST = 2, 8
"""Untimed steps after each restart, and the smallest number of timed ones.

After a restart the contact search starts again.
"""
PER_CORE, TWO_WORKERS = 0.90, 1.8
"""Targets: rate per core over the rate of a single run, and rate of two workers over that of one."""


@dataclass(frozen=True)
class BatchRate:
    """Steps per second of some copies.

    Attributes:
        scene, mesh: See cases.
        engine: "softsim" or "mujoco".
        nodes: Number of nodes of the scene.
        copies, workers: Number of copies and of workers.
        rate: Steps of all copies per second of wall time, the best sample.
        single: Rate of a single run in the same turns, by a plain Simulation, or MuJoCo with one copy.
    """

    scene: str
    mesh: str
    engine: str
    nodes: int
    copies: int
    workers: int
    rate: float
    single: float

    @property
    def per_core(self) -> float:
        """Rate per core in use over the rate of the single run, [-]."""
        return self.rate / (self.single * min(self.workers, self.copies))

    def as_json(self) -> dict[str, object]:
        """Return the measurement as a JSON object."""
        return {**asdict(self), "per_core": self.per_core}


def measure_copies(
    counts: Sequence[int], workers: Sequence[int], rounds: int, reference: Path
) -> Iterator[BatchRate]:
    """Measure all scenes, each in turns with its single run."""
    for scene, mesh in MEASURED:
        description = describe(scene, mesh, reference)
        with warnings.catch_warnings():  # the warnings about slivers are known
            warnings.simplefilter("ignore", UserWarning)
            single = _in_motion(scene, description)
            for count in counts:
                for cores in (each for each in workers if each <= count):
                    yield _rate(scene, mesh, description, single, (count, cores), rounds)


def _in_motion(scene: str, description: RobotDescription) -> Simulation:
    """Return a single run in the state in which the scene is measured."""
    if scene in TOUCHING:
        return TouchingScene(scene, description, "auto").simulation
    simulation = Simulation(description)
    simulation.command(list(description.poses["mid"]))
    for _ in range(30):
        simulation.step()
    return simulation


def _rate(
    scene: str,
    mesh: str,
    description: RobotDescription,
    single: Simulation,
    size: tuple[int, int],
    rounds: int,
) -> BatchRate:
    count, workers = size
    home, middle = single.snapshot(), single.joint_targets
    spread = np.random.default_rng(1).uniform(-1e-3, 1e-3, (count, len(middle)))
    best = alone = 0.0
    with Batch(description, count, workers) as batch, no_garbage_collection():

        def together(calls: int) -> float:
            batch.restore(home)
            batch.command(middle + spread)
            batch.step(COLD)
            started = perf_counter()
            batch.step(calls)
            return count * calls / (perf_counter() - started)

        def by_itself(calls: int) -> float:
            taken, steps = 0.0, 0
            while taken < SAMPLE_S:
                single.restore(home)
                single.command(middle + spread[0])
                for _ in range(COLD):
                    single.step()
                started = perf_counter()
                for _ in range(calls):
                    single.step()
                taken, steps = taken + perf_counter() - started, steps + calls
            return steps / taken

        calls = max(LEAST, round(SAMPLE_S * together(LEAST) / count))
        for _ in range(rounds):
            best, alone = max(best, together(calls)), max(alone, by_itself(calls))
    single.restore(home)
    return BatchRate(scene, mesh, "softsim", len(single.positions), count, workers, best, alone)


def measure_peer(
    counts: Sequence[int], workers: Sequence[int], rounds: int, reference: Path
) -> Iterator[BatchRate]:
    """Measure MuJoCo's own batched steps (mujoco.rollout) of the clamped silicone as a flex.

    Raises:
        MjcfError: MuJoCo is not installed.
    """
    for scene, mesh in PEERS:
        body = clamped_body(describe(scene, mesh, reference))
        run = MujocoRun(export_mjcf(body.scene).text)
        mujoco, rollout = import_module("mujoco"), import_module("mujoco.rollout")
        full = mujoco.mjtState.mjSTATE_FULLPHYSICS
        start = np.zeros(mujoco.mj_stateSize(run.model, full))
        mujoco.mj_getState(run.model, run.data, start, full)
        alone = 0.0
        for count in counts:
            for threads in (each for each in workers if each <= count):
                model_data = [mujoco.MjData(run.model) for _ in range(threads)]
                states = np.tile(start, (count, 1))
                best, calls = 0.0, 2
                for _ in range(rounds):
                    started = perf_counter()
                    rollout.rollout(run.model, model_data, states, nstep=calls)
                    taken = perf_counter() - started
                    best = max(best, count * calls / taken)
                    calls = max(2, math.ceil(SAMPLE_S * best / count))
                alone = alone or best
                yield BatchRate(scene, mesh, "mujoco", len(body.points), count, threads, best, alone)


def peer_missing() -> str | None:
    """Return why MuJoCo is not measured; None if it is available."""
    try:
        import_module("mujoco.rollout")
    except (ImportError, MjcfError) as error:
        return f"MuJoCo is not measured: {error}; {install_command('peers')}"
    return None


def describe_missed_targets(rates: Sequence[BatchRate]) -> list[str]:
    """Return one line for each missed target."""
    ours = [each for each in rates if each.engine == "softsim"]
    lines = [
        f"{each.scene} {each.mesh}, {each.copies} copies: {each.per_core:.2f} of the single run per core, "
        f"target >= {PER_CORE}"
        for each in ours
        if each.workers == 1 and each.per_core < PER_CORE
    ]
    for two in (each for each in ours if each.workers == 2):
        for one in ours:
            if (one.scene, one.mesh, one.copies, one.workers) == (two.scene, two.mesh, two.copies, 1):
                gain = two.rate / two.single * one.single / one.rate
                if gain < TWO_WORKERS:
                    lines.append(
                        f"{two.scene} {two.mesh}, {two.copies} copies: two workers {gain:.2f} times one, "
                        f"target >= {TWO_WORKERS}"
                    )
    return lines


def rate_table(rates: Sequence[BatchRate]) -> list[str]:
    """Return the rates as lines of aligned columns, head first."""
    head = ("engine", "scene", "mesh", "nodes", "copies", "cores", "steps/s", "single", "per core")
    return align_columns(
        [
            head,
            *(
                (
                    each.engine,
                    each.scene,
                    each.mesh,
                    str(each.nodes),
                    str(each.copies),
                    str(each.workers),
                    f"{each.rate:.0f}",
                    f"{each.single:.0f}",
                    f"{each.per_core:.2f}",
                )
                for each in rates
            ),
        ]
    )
