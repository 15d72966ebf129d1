"""The simulator's parameters: which exist, what they allow, and what a change at run time does."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from rclpy.node import Node

from softsim_core.fem.materials import material, material_names
from softsim_core.scene.catalog import folders_of
from softsim_core.scene.robot import RobotDescription
from softsim_core.simulation import Simulation
from softsim_node.parameters import ParameterError
from softsim_ros.runtime import declare_number, declare_switch, declare_text
from softsim_ros.simulator.snapshot_folder import SnapshotFolder, default_folder

BACKENDS = ("auto", "numba", "scipy")
OUT_OF_RANGE = ("clamp", "refuse")
DAMPING = ("rayleigh_stiffness", "rayleigh_mass")
RANGES = {"young_modulus": (1.0, 1.0e12), "poisson_ratio": (-0.99, 0.499)}
"""Ranges of material parameters as ROS parameters; of others it is the interval of the law."""
SLOWEST = 1.0e-3
"""Least speed but 0, in simulated seconds a wall second; at slower ones a step comes after minutes."""
LARGEST = 1.0e12
"""End of a range that a law leaves open."""


class Tuning(NamedTuple):
    """How a physical parameter is read from and written to a running simulation."""

    read: Callable[[Simulation], float]
    write: Callable[[Simulation, float], None]


@dataclass(frozen=True)
class StartParameters:
    """Values at start.

    Attributes:
        robot: The robot with what the parameters say laid over it.
        backend: Implementation of the step.
        speed: Simulated seconds a wall second; 0 is as fast as possible.
        mesh_rate: Messages a second on mesh/points, in [Hz].
        marker_stress: Stress in [Pa] of the marker's last colour; 0 takes the largest of each message.
        publish_clock: Whether simulated time goes to /clock and into the stamps.
        watch: Whether the scene is loaded anew when one of its files is saved.
        snapshots: Where snapshots are kept.
        tunings: Parameters of the physics that change at run time, by name.
    """

    robot: RobotDescription
    backend: str
    speed: float
    mesh_rate: float
    marker_stress: float
    publish_clock: bool
    watch: bool
    snapshots: SnapshotFolder
    tunings: dict[str, Tuning]


def checked_speed(speed: float) -> float:
    """Simulated seconds a wall second.

    Raises:
        ParameterError: slower than SLOWEST, but not 0.
    """
    if 0.0 < speed < SLOWEST:
        raise ParameterError(f"parameter speed = {speed:g} is refused; allowed: 0.0, {SLOWEST:g} to 1000")
    return speed


def declare_overrides(node: Node) -> str:
    """Declare and return what is laid over the scene's file; another text can be set at run time."""
    return declare_text(
        node,
        "overrides",
        "",
        "Values laid over the scene's file, as YAML: {gravity: [0, 0, -1.6]}; it begins anew with them",
        read_only=False,
    )


def declare_snapshots(node: Node, robot: str) -> SnapshotFolder:
    """Declare the name of the snapshot, which can be set at run time, and its folder; returns the folder.

    Raises:
        SnapshotError: the name is not allowed.
    """
    folder = declare_text(
        node,
        "snapshot_folder",
        str(default_folder()),
        "Folder of the snapshots, which lie there under their names",
    )
    name = declare_text(
        node, "snapshot", robot, "Name of the snapshot that ~/save writes and ~/load reads", read_only=False
    )
    snapshots = SnapshotFolder(Path(folder))
    snapshots.file(name)
    return snapshots


def declare_allowed_code(node: Node) -> list[str]:
    """Declare and return the folders whose Python scenes may be loaded while the node runs."""
    text = declare_text(
        node,
        "allow_code",
        "",
        "Folders whose Python scenes may be loaded by name at run time, separated as in PATH; they run code",
    )
    return folders_of(text)


def clear_overrides(node: Node) -> None:
    """Make the parameter `overrides` empty, also where one was given at start: another scene runs."""
    descriptor = node.describe_parameter("overrides")
    node.undeclare_parameter("overrides")
    node.declare_parameter("overrides", "", descriptor, ignore_override=True)


def declare_parameters(node: Node, robot: RobotDescription, named: str) -> StartParameters:
    """Declare all parameters but `robot`; defaults come from the scene.

    Raises:
        ParameterError: a value given at start is not allowed.
        SceneError: the scene does not allow it.
    """
    backend = declare_text(
        node, "backend", robot.scene.solver.backend, "Implementation of the step", choices=BACKENDS
    )
    out_of_range = declare_text(
        node,
        "out_of_range",
        robot.commands.out_of_range,
        "What happens to a command beyond the limits: it is clamped, or refused whole",
        choices=OUT_OF_RANGE,
    )
    enforce = declare_switch(
        node,
        "enforce_limits",
        robot.commands.enforce_limits,
        "Keep joint limits (position and speed); false allows full turns, in simulation only",
    )
    snapshots = declare_snapshots(node, named)
    watch = declare_switch(
        node, "watch", False, "Load the scene anew whenever one of its files is saved", read_only=True
    )
    clock = declare_switch(
        node, "publish_clock", False, "Send simulated time on /clock and stamp with it", read_only=True
    )
    speed = checked_speed(
        declare_number(
            node,
            "speed",
            1.0,
            f"Simulated seconds a wall second, at least {SLOWEST:g}; 0.0 is as fast as possible",
            0.0,
            1000.0,
        )
    )
    mesh_rate = declare_number(
        node, "mesh_rate", 30.0, "Messages a second on mesh/points, in Hz; 0.0 sends none", 0.0, 1000.0
    )
    marker_stress = declare_number(
        node,
        "marker_stress",
        0.0,
        "Stress in Pa of the last colour of mesh/marker; 0.0 takes the largest of each message",
        0.0,
        1.0e12,
    )
    robot, tunings = _declare_physics(node, robot)
    commands = dataclasses.replace(
        robot.commands, enforce_limits=enforce, out_of_range="refuse" if out_of_range == "refuse" else "clamp"
    )
    return StartParameters(
        robot=dataclasses.replace(robot, commands=commands),
        backend=backend,
        speed=speed,
        mesh_rate=mesh_rate,
        marker_stress=marker_stress,
        publish_clock=clock,
        watch=watch,
        snapshots=snapshots,
        tunings=tunings,
    )


def declare_physics_again(node: Node, robot: RobotDescription, start: StartParameters) -> StartParameters:
    """Parameters of material and damping for another scene, in place of those of `start`.

    Returns:
        `start` with the other scene; limits and what happens beyond them stay as the node was started.

    Raises:
        ParameterError: a value is out of range; some parameters may be missing until the next call.
    """
    physical = {*DAMPING, *(each for law in material_names() for each in material(law).names)}
    for name in list(node.get_parameters_by_prefix("")):
        if name.rpartition(".")[2] in physical:
            node.undeclare_parameter(name)
    robot = dataclasses.replace(robot, commands=start.robot.commands)
    robot, tunings = _declare_physics(node, robot)
    return dataclasses.replace(start, robot=robot, tunings=tunings)


def _declare_physics(node: Node, robot: RobotDescription) -> tuple[RobotDescription, dict[str, Tuning]]:
    """Parameters of laws, as `young_modulus`, and damping; of several bodies `BODY.young_modulus`."""
    scene, tunings = robot.scene, dict[str, Tuning]()
    bodies = []
    for body in scene.bodies:
        prefix = f"{body.name}." if len(scene.bodies) > 1 else ""
        values = {}
        for parameter in body.material.law_for(scene.solver.rotation).parameters:
            unit = "" if parameter.unit == "-" else f" in {parameter.unit}"
            values[parameter.name] = declare_number(
                node,
                f"{prefix}{parameter.name}",
                body.material.values[parameter.name],
                f"{parameter.description} of {body.name}{unit}",
                *RANGES.get(parameter.name, (max(parameter.lower, -LARGEST), min(parameter.upper, LARGEST))),
            )
            tunings[f"{prefix}{parameter.name}"] = _material_parameter(body.name, parameter.name)
        bodies.append(dataclasses.replace(body, material=body.material.changed(**values)))
    stiffness = declare_number(
        node, "rayleigh_stiffness", scene.solver.rayleigh_stiffness, "Damping per stiffness in s", 0.0, 10.0
    )
    mass = declare_number(
        node, "rayleigh_mass", scene.solver.rayleigh_mass, "Damping per mass in 1/s", 0.0, 1.0e4
    )
    tunings["rayleigh_stiffness"] = Tuning(
        lambda simulation: simulation.parameters.rayleigh_stiffness,
        lambda simulation, value: simulation.set_damping(rayleigh_stiffness=value),
    )
    tunings["rayleigh_mass"] = Tuning(
        lambda simulation: simulation.parameters.rayleigh_mass,
        lambda simulation, value: simulation.set_damping(rayleigh_mass=value),
    )
    solver = dataclasses.replace(scene.solver, rayleigh_stiffness=stiffness, rayleigh_mass=mass)
    return robot.with_scene(bodies=tuple(bodies), solver=solver), tunings


def _material_parameter(body: str, name: str) -> Tuning:
    return Tuning(
        lambda simulation: simulation.material(body).values[name],
        lambda simulation, value: simulation.set_material(body, **{name: value}),
    )
