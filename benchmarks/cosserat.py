"""Solve the experiments of cosseratbench, a suite for simulators of rods, beside the solvers that it drives.

`RodSolver` is a plug-in of the suite: it builds a scene from the suite's scenario, runs it, and returns the
motion that the suite measures. What the scene cannot express raises NotImplementedError, which the suite
reports as unsupported.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from time import process_time
from typing import Any, ClassVar, Final

import numpy as np
from cosseratbench import (
    Capability,
    Diverged,
    End,
    EndCondition,
    Motion,
    Plane,
    Result,
    Rod,
    Scenario,
    Trajectory,
    registry,
    run,
)

from benchmarks.records import align_columns
from softsim_core import Simulation
from softsim_core.base import Array, Box, IndexArray, Placement, SolverDivergedError
from softsim_core.physics.contact import ContactSettings, PairFriction
from softsim_core.physics.mesh import Shape
from softsim_core.scene import (
    AttachmentDescription,
    BodyDescription,
    CollisionDescription,
    JointDescription,
    MaterialDescription,
    RigidBodyDescription,
    RodClampDescription,
    RodDescription,
    RodSectionDescription,
    SceneDescription,
    SolverSettings,
)

MEASURES: Final = {
    "cantilever": "tip_deflection_error",
    "catenary": "shape_error",
    "pendulum": "period_error",
    "twist": "critical_twist_error",
    "crossing": "lift_error",
    "capstan": "slide",
    "pile": "max_rod_overlap",
}
"""Measure of each experiment by which solvers are ranked: less is better, zero is exact."""

QUICK_EXPERIMENTS: Final = ("cantilever", "catenary", "pendulum")
OURS: Final = "softsim"
NOT_FIRST: Final = 2
"""Number of experiments in which another solver may be the first."""
STEP, STEP_TO_REST = 2.5e-3, 1.0e-2
"""Largest time steps in [s]: where motion is the result, and where only rest is."""
SKIN: Final = 0.9
"""Contact distance in radii of the thinnest rod; the rods are thinner by half of it on each side."""
LOOSE: Final = 1e-9
"""Stiffness of a pin against rotation, in bending stiffnesses of the rod over its length."""
SLIDE: Final = 1e-6
"""Stiffness of a sliding end's spring, in axial stiffnesses of the rod over its length."""
SHEAR_SHARE: Final = 27.0 / 28.0
"""Part of the area of a circle that carries shear, as the suite's other solver with shear takes it."""
LARGE: Final = 10.0
"""Edge in [m] of the square that stands for a plane."""

HEAD: Final = (
    "experiment", "solver", "outcome", "measure", "value", "place", "s", "s/ours", "sinks in", "overlap",
)  # fmt: skip
"""Columns of the table; s is processor time, the last two are in radii of the rod."""

Track = tuple[Array, Array]
"""Times in [s] and commands of a joint, in [m] or [rad]."""


@dataclass
class SceneParts:
    """Parts of a scene, collected rod by rod and obstacle by obstacle.

    Attributes:
        skin: Contact distance in [m].
        tracks: Commands of the joints, in their order.
    """

    skin: float
    bodies: list[BodyDescription] = field(default_factory=list)
    joints: list[JointDescription] = field(default_factory=list)
    attachments: list[AttachmentDescription] = field(default_factory=list)
    rigid_bodies: list[RigidBodyDescription] = field(default_factory=list)
    collisions: list[CollisionDescription] = field(default_factory=list)
    tracks: list[Track] = field(default_factory=list)

    def add_rod(self, name: str, rod: Rod, cells: int, touches_itself: bool) -> None:
        """Add a rod, what holds or moves its ends, and its collision surfaces."""
        self.bodies.append(rod_body(name, rod, cells, self.skin))
        for end in End:
            if rod.condition(end) is EndCondition.FREE:
                continue
            motion, to = rod.motion(end), "world"
            if motion is not None:
                to = self._add_joints(f"{name}_{end.value}", rod, end, motion)
            self.attachments.append(
                AttachmentDescription(name=f"{name}_{end.value}", body=name, to=to, end=end.value)
            )
        if not touches_itself:
            self.collisions.append(CollisionDescription(name=name, body=name))
            return
        places = drawn_places(rod, cells)
        for k in range(cells):  # neighbours share a group, so that only pairs with a cell between them touch
            self.collisions.append(
                CollisionDescription(
                    name=f"{name}_{k}",
                    body=name,
                    boxes=(box_around(places[2 * k : 2 * k + 3], rod.radius),),
                    groups=(f"{name}_{k}", f"{name}_{k + 1}"),
                )
            )

    def _add_joints(self, name: str, rod: Rod, end: End, motion: Motion) -> str:
        """Add the chain of joints that moves an end; return the name of the last one."""
        shifts, turns = np.asarray(motion.displacement, dtype=float), np.asarray(motion.rotation, dtype=float)
        chain: list[tuple[str, Array, float | None, Array]] = [
            ("prismatic", axis, None, shifts @ axis) for axis in np.eye(3) if (shifts @ axis).any()
        ]
        if motion.slides_along is not None:
            spring = SLIDE * rod.material.youngs_modulus * rod.area / rod.length
            chain.append(("prismatic", np.asarray(motion.axis), spring, np.zeros(len(shifts))))
        if turns.any():
            axis = turns[np.argmax(np.linalg.norm(turns, axis=1))]
            axis = axis / np.linalg.norm(axis)
            if np.linalg.norm(np.cross(turns, axis), axis=1).max() > 1e-9:
                raise NotImplementedError("an end that turns about several axes")
            chain.append(("revolute", axis, None, turns @ axis))
        x, y, z = rod.nodes(1)[0 if end is End.START else -1].tolist()
        for k, (kind, axis, stiffness, values) in enumerate(chain):
            joint = JointDescription(
                name=f"{name}_{k}",
                kind=kind,
                parent=f"{name}_{k - 1}" if k else None,
                base=Placement(translation=(x, y, z)),
                axis=(float(axis[0]), float(axis[1]), float(axis[2])),
                stiffness=stiffness,
            )
            self.joints.append(joint)
            self.tracks.append((np.asarray(motion.times, dtype=float), values))
        return f"{name}_{len(chain) - 1}" if chain else "world"

    def add_obstacle(self, name: str, obstacle: Any) -> None:
        """Add a plane or a cylinder, smaller by half of the skin."""
        if isinstance(obstacle, Plane):
            normal, shape = obstacle.unit_normal, Shape(plane=(LARGE, LARGE))
            place = np.asarray(obstacle.point) - 0.5 * self.skin * normal
        else:
            normal, place = obstacle.unit_axis, np.asarray(obstacle.center)
            shape = Shape(cylinder=(obstacle.radius - 0.5 * self.skin, obstacle.length))
        if normal[2] > 1.0 - 1e-12:
            tilt = 0.0
        elif shape.cylinder is not None and abs(normal[1]) > 1.0 - 1e-12:
            tilt = 90.0
        else:
            raise NotImplementedError("a plane that is not level, or a cylinder that is not along y or z")
        x, y, z = place.tolist()
        pose = Placement(translation=(x, y, z), rotation_deg=(tilt, 0.0, 0.0))
        self.rigid_bodies.append(RigidBodyDescription(name=name, shape=shape, pose=pose))
        self.collisions.append(CollisionDescription(name=name, body=name, groups=("obstacles",)))

    def scene(self, scenario: Scenario, dt: float, step_settings: SolverSettings) -> SceneDescription:
        """Return the scene of a scenario."""
        touching = can_touch(scenario)
        pairs = [
            PairFriction(between=(body.name, thing.name), friction=max(rod.friction, obstacle.friction))
            for body, rod in zip(self.bodies, scenario.rods, strict=True)
            for thing, obstacle in zip(self.rigid_bodies, scenario.obstacles, strict=True)
        ]
        contact = ContactSettings(
            contact_distance=self.skin,
            friction=max(rod.friction for rod in scenario.rods),
            friction_pairs=tuple(pairs),
        )
        return SceneDescription(
            name="cosseratbench",
            dt=dt,
            gravity=scenario.gravity,
            solver=step_settings,
            bodies=tuple(self.bodies),
            joints=tuple(self.joints),
            attachments=tuple(self.attachments),
            rigid_bodies=tuple(self.rigid_bodies),
            collisions=tuple(self.collisions) if touching else (),
            contact=contact if touching else ContactSettings(),
        )


def can_touch(scenario: Scenario) -> bool:
    """Return whether a scenario has anything that can touch."""
    return bool(scenario.obstacles) or len(scenario.rods) > 1 or scenario.self_contact


def box_around(places: Array, radius: float) -> Box:
    """Return the box around the sections at places (3, 3) of a rod that is drawn along an axis.

    Raises:
        NotImplementedError: it is drawn across the axes.
    """
    low, high = places.min(axis=0), places.max(axis=0)
    along = int(np.argmax(high - low))
    size = high - low + 4.0 * radius
    size[along] = 1.01 * (high - low)[along]
    if (high - low)[along] < 0.99 * np.linalg.norm(places[-1] - places[0]):
        raise NotImplementedError("a rod that can touch itself and starts across the axes")
    x, y, z = (0.5 * (low + high)).tolist()
    a, b, c = size.tolist()
    return Box(center=(x, y, z), size=(a, b, c))


def drawn_places(rod: Rod, cells: int) -> Array:
    """Return the places in [m] of the sections of a rod as drawn, evenly stretched, (2 cells + 1, 3)."""
    points = rod.nodes(2 * cells)
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    even = np.linspace(0.0, lengths[-1], len(points))
    return np.column_stack([np.interp(even, lengths, each) for each in points.T])


def rod_body(name: str, rod: Rod, cells: int, skin: float) -> BodyDescription:
    """Return a rod of the suite as a body, thinner by half of the skin; stiffness and mass stay."""
    young, shear = rod.material.youngs_modulus, rod.material.shear_modulus
    bending, across = young * rod.second_moment_of_area, SHEAR_SHARE * shear * rod.area
    radius = rod.radius - 0.5 * skin
    loose = LOOSE * bending / rod.length
    # A straight round rod whose other end is free to rotate carries no twist: only one pin lets it rotate.
    start = RodClampDescription(rotation=(loose, loose, math.inf))
    end = start if rod.start is not EndCondition.PINNED else RodClampDescription(rotation=(loose,) * 3)
    described = RodDescription(
        centreline=tuple((x, y, z) for x, y, z in rod.nodes(2 * cells).tolist()),
        section=RodSectionDescription(
            shape="ellipse",
            size=(2.0 * radius, 2.0 * radius),
            stiffness=(
                young * rod.area, across, across, bending, bending, 2.0 * shear * rod.second_moment_of_area
            ),
        ),
        first_axis=tuple(rod.directors(2 * cells)[0].tolist()),
        elements=cells,
        natural="straight",
        length=rod.length,
        start_clamp=start if rod.start is EndCondition.PINNED else None,
        end_clamp=end if rod.end is EndCondition.PINNED else None,
    )  # fmt: skip
    return BodyDescription(
        name=name,
        rod=described,
        material=MaterialDescription(law="rod", young_modulus=young, poisson_ratio=0.3),
        density=rod.material.density * (rod.radius / radius) ** 2,
    )


@dataclass
class RodSolver:
    """Our rods as a solver of cosseratbench.

    Attributes:
        time_step_scale: Factor on the time step, an option of the suite.
    """

    time_step_scale: float = 1.0

    name: ClassVar[str] = OURS
    backend_version: ClassVar[str] = version("softsim")
    capabilities: ClassVar[frozenset[Capability]] = frozenset(Capability)

    def settings(self, scenario: Scenario, *, n_elements: int, n_frames: int) -> dict[str, object]:
        """Return the numerical choices for a scenario, which the suite records."""
        parts, dt = self._steps(scenario, n_frames)
        return {
            "method": "statics" if is_static(scenario) else "Bossak's method",
            "time_step": dt,
            "steps_per_frame": parts,
            "sections": 2 * cells_of(n_elements) + 1,
            "damping_rate": damping_of(scenario),
            "contact_distance": SKIN * min(rod.radius for rod in scenario.rods),
        }

    def _steps(self, scenario: Scenario, n_frames: int) -> tuple[int, float]:
        """Return the number of steps per frame, and the step in [s]."""
        interval = scenario.duration / (n_frames - 1)
        longest = self.time_step_scale * (STEP_TO_REST if scenario.quasi_static else STEP)
        parts = max(1, math.ceil(interval / longest - 1e-9))
        return parts, interval / parts

    def run(self, scenario: Scenario, *, n_elements: int, n_frames: int) -> Trajectory:
        """Return the motion of a scenario's rods.

        Raises:
            NotImplementedError: a scene cannot express it.
            Diverged: a step failed.
        """
        parts, dt = self._steps(scenario, n_frames)
        cells = cells_of(n_elements)
        skin = SKIN * min(rod.radius for rod in scenario.rods) if can_touch(scenario) else 0.0
        built = SceneParts(skin)
        for i, rod in enumerate(scenario.rods):
            built.add_rod(f"rod_{i}", rod, cells, scenario.self_contact)
        for i, obstacle in enumerate(scenario.obstacles):
            built.add_obstacle(f"obstacle_{i}", obstacle)
        step_settings = SolverSettings(
            time_integration="bossak",
            spectral_radius=0.8 if scenario.quasi_static else 1.0,
            rayleigh_mass=damping_of(scenario),
        )
        simulation = Simulation(built.scene(scenario, dt, step_settings))
        sections = place_rods(simulation, scenario.rods, cells)
        frames = [observe(simulation, sections, n_elements)]
        if is_static(scenario):
            simulation.settle([])
            frames += [observe(simulation, sections, n_elements)] * (n_frames - 1)
        while len(frames) < n_frames:
            for _ in range(parts):
                if built.tracks:
                    simulation.command(
                        [float(np.interp(simulation.time + dt, *track)) for track in built.tracks]
                    )
                try:
                    simulation.step()
                except SolverDivergedError as error:
                    raise Diverged(str(error), error.time_s) from error
            frames.append(observe(simulation, sections, n_elements))
        places, directors = (
            tuple(np.stack([each[part][i] for each in frames]) for i in range(len(sections)))
            for part in (0, 1)
        )
        return Trajectory(np.linspace(0.0, scenario.duration, n_frames), places, directors)


def cells_of(n_elements: int) -> int:
    """Return the number of cells with as many sections as the suite's elements have nodes, about."""
    return math.ceil(n_elements / 2)


def damping_of(scenario: Scenario) -> float:
    """Return the damping per mass in [1/s]: critical for the slowest mode where only rest counts."""
    return 2.0 * scenario.slowest_frequency() if scenario.quasi_static else 0.0


def is_static(scenario: Scenario) -> bool:
    """Return whether statics solve it: only rest counts, nothing touches, and nothing moves its ends."""
    driven = any(rod.motion(end) is not None for rod in scenario.rods for end in End)
    return scenario.quasi_static and not can_touch(scenario) and not driven


def place_rods(simulation: Simulation, rods: Sequence[Rod], cells: int) -> list[IndexArray]:
    """Stretch the rods as the scenario says, and load their ends; return the nodes of their sections.

    The nodes have the shape (2 cells + 1, 3) for each rod, without those of pins.
    """
    sections, shift = [], np.zeros_like(simulation.positions)
    for rod, body in zip(rods, simulation.bodies, strict=True):
        first = body.nodes.start + (6 if rod.start is EndCondition.PINNED else 0)
        nodes = first + np.arange(3 * (2 * cells + 1)).reshape(-1, 3)
        shift[nodes] = (rod.nodes(2 * cells) - simulation.positions[nodes].mean(axis=1))[:, None]
        for load in rod.loads:
            simulation.forces[nodes[0 if load.at is End.START else -1]] += np.asarray(load.force) / 3.0
        sections.append(nodes)
    model = simulation.model
    simulation.displace(shift[model.free_nodes], np.zeros(model.reduced_size))
    return sections


def observe(
    simulation: Simulation, sections: Sequence[IndexArray], n_elements: int
) -> tuple[list[Array], list[Array]]:
    """Return node places in [m] and directors of each rod, (n_elements + 1, 3) and (n_elements, 3)."""
    positions = simulation.positions
    places, directors = [], []
    for nodes in sections:
        centres = positions[nodes].mean(axis=1)
        place = along_cells(centres, n_elements)
        first = along_cells(positions[nodes[:, 0]] - centres, n_elements)
        tangent = np.diff(place, axis=0)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        across = first[1:] + first[:-1]
        across -= (across * tangent).sum(axis=1, keepdims=True) * tangent
        places.append(place)
        directors.append(across / np.linalg.norm(across, axis=1, keepdims=True))
    return places, directors


def along_cells(values: Array, n_elements: int) -> Array:
    """Return the quadratic interpolation of sections' values (2 m + 1, 3) at even places along the rod."""
    at = np.linspace(0.0, len(values) // 2, n_elements + 1)
    cell = np.minimum(at.astype(int), len(values) // 2 - 1)
    xi = (2.0 * (at - cell) - 1.0)[:, None]
    before, middle, after = (values[2 * cell + k] for k in range(3))
    return np.asarray(0.5 * xi * (xi - 1.0) * before + (1.0 - xi**2) * middle + 0.5 * xi * (xi + 1.0) * after)


@dataclass
class TimedSolver:
    """A solver whose last run is timed in processor time, which other programs on the machine change little.

    Attributes:
        solver: The solver.
        seconds: Processor time of the last run in [s].
    """

    solver: Any
    seconds: float = math.nan

    def __getattr__(self, name: str) -> Any:
        return getattr(self.solver, name)

    def run(self, scenario: Scenario, *, n_elements: int, n_frames: int) -> Trajectory:
        """Return the solver's motion."""
        started = process_time()
        try:
            motion: Trajectory = self.solver.run(scenario, n_elements=n_elements, n_frames=n_frames)
            return motion
        finally:
            self.seconds = process_time() - started


@dataclass
class Score:
    """Outcome of a solver on an experiment.

    Attributes:
        result: What the suite reports.
        seconds: Processor time of the run in [s].
        place: Rank by the experiment's measure, from 1; None without one.
        ratio: Processor time over ours.
    """

    result: Result
    seconds: float
    place: int | None = None
    ratio: float = math.nan

    @property
    def value(self) -> float:
        """Value of the experiment's measure; NaN where it was not completed."""
        found = {**self.result.metrics, **self.result.observations}
        return float(found.get(MEASURES[self.result.experiment], math.nan))

    def as_json(self) -> dict[str, object]:
        """Return the measurement as a JSON object."""
        timed = {"place": self.place, "processor_s": self.seconds, "ratio": self.ratio}
        return {**self.result.summary(), **timed}


def peers() -> list[str]:
    """Return the names of the suite's other solvers."""
    return [name for name in registry.names(registry.SOLVERS) if name != OURS]


def measure_experiment(
    name: str, solvers: Sequence[str], say: Callable[[str], None]
) -> tuple[list[Score], list[str]]:
    """Run an experiment with our solver and those of the suite; return scores and notes.

    Ours runs twice, and the second run counts: the first compiles kernels when rods touch, after the
    warm-up of the suite.
    """
    experiment, scores, notes = registry.load_experiment(name), [], []
    for solver in (OURS, *solvers):
        try:
            chosen = TimedSolver(RodSolver() if solver == OURS else registry.load_solver(solver))
        except ImportError as error:
            notes.append(f"{solver} is not measured: {error.name} is not installed")
            continue
        say(f"{name}: {solver} ...")
        try:
            result = [run(experiment, chosen) for _ in range(2 if solver == OURS else 1)][-1]
        except Exception as error:  # of another project: report it and go on
            notes.append(f"{name}: {solver} failed: {type(error).__name__}: {error}")
            continue
        scores.append(Score(result, chosen.seconds))
    set_places(scores)
    return scores, notes


def set_places(scores: Sequence[Score]) -> None:
    """Set the ranks, and the times over that of our solver."""
    finite = sorted(score.value for score in scores if math.isfinite(score.value))
    ours = [score.seconds for score in scores if score.result.solver == OURS]
    for score in scores:
        if math.isfinite(score.value):
            score.place = 1 + finite.index(score.value)
        if ours and score.result.supported:
            score.ratio = score.seconds / ours[0]


def score_table(scores: Sequence[Score]) -> list[str]:
    """Return the lines of a table."""
    rows: list[tuple[str, ...]] = [HEAD]
    for score in scores:
        result = score.result
        deep = [result.observations.get(key, math.nan) for key in ("max_penetration", "max_rod_overlap")]
        rows.append(
            (
                result.experiment, result.solver, result.outcome, MEASURES[result.experiment],
                f"{score.value:.2e}", str(score.place or "-"),
                f"{score.seconds:.2f}", f"{score.ratio:.2f}",
                *(f"{each:.2g}" for each in deep),
            )
        )  # fmt: skip
    return align_columns(rows)
