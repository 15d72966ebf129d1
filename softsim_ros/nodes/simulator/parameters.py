"""Parameters of the simulator node, including those of the physics."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from rclpy.node import Node
from rclpy.parameter import Parameter

from softsim_core.scene import RobotDescription
from softsim_core.simulation import Simulation
from softsim_node import (
    ParameterChanges,
    ParameterError,
    ParameterInfo,
    check_value,
    declare_value,
    parameter,
)
from softsim_ros import RobotSettings
from softsim_ros.nodes.simulator.services import default_folder

BACKENDS = ("auto", "numba", "scipy")
OUT_OF_RANGE = ("clamp", "refuse")
SLOWEST = 1.0e-3
"""Smallest speed above 0, in simulated seconds per wall second; at lower speeds a step may take minutes."""


@dataclass(frozen=True, kw_only=True)
class SceneSettings(RobotSettings):
    """Parameters that choose the scene; they are declared first, as other defaults depend on them."""

    robot: str = parameter(
        "tripod", "Robot or scene: a name such as tripod; at the start also the path of a .yaml or .py file"
    )
    overrides: str = parameter(
        "",
        "Values laid over the scene's file, as YAML text: 'gravity: [0, 0, -1.6]'; the scene restarts with "
        "them",
    )
    allow_code: str = parameter(
        "",
        "Folders whose scenes may be loaded by name at run time, separated as in PATH; they may run code",
        fixed=True,
    )


@dataclass(frozen=True, kw_only=True)
class SimulatorSettings(SceneSettings):
    """Values of the parameters."""

    backend: str = parameter("auto", "Implementation of the step", choices=BACKENDS, fixed=True)
    out_of_range: str = parameter(
        "clamp",
        "What happens to a command beyond the limits: it is clamped, or refused whole",
        choices=OUT_OF_RANGE,
        fixed=True,
    )
    follow_joint_states: str = parameter(
        "",
        "Topic of joint states that joints of the same names follow, as those of a real arm; empty: none",
        fixed=True,
    )
    enforce_limits: bool = parameter(
        True, "Keep joint limits (position and speed); false allows full turns, in simulation only"
    )
    snapshot_folder: str = parameter(
        str(default_folder()), "Folder of the snapshots, which lie there under their names", fixed=True
    )
    snapshot: str = parameter("", "Name of the snapshot that ~/save writes and ~/load reads")
    editing: bool = parameter(
        True,
        "Let others propose changes of the scene's file, apply and save them; see docs/edit.md",
        fixed=True,
    )
    watch: bool = parameter(False, "Reload the scene whenever one of its files is saved", fixed=True)
    publish_clock: bool = parameter(False, "Send simulated time on /clock and stamp with it", fixed=True)
    speed: float = parameter(
        1.0,
        f"Simulated seconds per wall second, at least {SLOWEST:g}; 0.0 is as fast as possible",
        within=(0.0, 1000.0),
    )
    mesh_rate: float = parameter(
        30.0, "Messages per second on mesh/points; 0.0 sends none", unit="Hz", within=(0.0, 1000.0)
    )
    marker_stress: float = parameter(
        0.0,
        "Stress of the last colour of mesh/marker; 0.0 takes the largest of each message",
        unit="Pa",
        within=(0.0, 1.0e12),
    )

    @classmethod
    def of(cls, robot: RobotDescription, first: SceneSettings, snapshot: str) -> SimulatorSettings:
        """Return the settings that a robot's file asks for, with the name of its snapshot."""
        return cls(
            robot=first.robot,
            overrides=first.overrides,
            allow_code=first.allow_code,
            backend=robot.scene.solver.backend,
            out_of_range=robot.commands.out_of_range,
            enforce_limits=robot.commands.enforce_limits,
            snapshot=snapshot,
        )

    def over(self, robot: RobotDescription) -> RobotDescription:
        """Return the robot with its command limits set as the parameters say."""
        refuses = self.out_of_range == "refuse"
        commands = replace(
            robot.commands,
            enforce_limits=self.enforce_limits,
            out_of_range="refuse" if refuses else "clamp",
        )
        return replace(robot, commands=commands)


def check_speed(speed: float) -> None:
    """Raise if a simulation would practically stand still: 0 < speed < SLOWEST.

    Raises:
        ParameterError: it would.
    """
    if 0.0 < speed < SLOWEST:
        raise ParameterError(f"parameter speed = {speed:g} is refused; allowed: 0.0, {SLOWEST:g} to 1000")


RANGES = {"young_modulus": (1.0, 1.0e12), "poisson_ratio": (-0.99, 0.4999)}
"""Ranges of material parameters as ROS parameters; other parameters take the interval of their law."""

LARGEST = 1.0e12
"""Upper bound of a range that a law leaves open."""

SCENE = {"robot", "overrides"}
"""Parameters that load another scene, and with it other parameters of the physics."""


class Tunable(NamedTuple):
    """A physical parameter: its value in the scene's file, and its access in a running simulation."""

    value: float
    about: ParameterInfo
    read: Callable[[Simulation], float]
    write: Callable[[Simulation, float], None]


def tunables(robot: RobotDescription) -> dict[str, Tunable]:
    """Return the parameters of laws and damping by name, as `young_modulus`.

    With several bodies the name is `BODY.young_modulus`. Parameters of a layer, of fibres or of a region are
    `LAYER.young_modulus` or `BODY.LAYER.young_modulus`.
    """
    scene, found = robot.scene, dict[str, Tunable]()
    for number, ((owner, values), law) in enumerate(zip(scene.materials, scene.laws, strict=True)):
        prefix = scene.parameter_prefix(owner)
        for each in law.parameters:
            ends = (max(each.lower, -LARGEST), min(each.upper, LARGEST))
            about = ParameterInfo(
                text=f"{each.description} of {owner}",
                unit="" if each.unit == "-" else each.unit,
                within=RANGES.get(each.name, ends),
            )
            read_and_write = _of_material(number, owner, each.name)
            found[f"{prefix}{each.name}"] = Tunable(values[each.name], about, *read_and_write)
    found["rayleigh_stiffness"] = Tunable(
        scene.solver.rayleigh_stiffness,
        ParameterInfo(text="Damping per stiffness", unit="s", within=(0.0, 10.0)),
        lambda simulation: simulation.parameters.rayleigh_stiffness,
        lambda simulation, value: simulation.set_damping(rayleigh_stiffness=value),
    )
    found["rayleigh_mass"] = Tunable(
        scene.solver.rayleigh_mass,
        ParameterInfo(text="Damping per mass", unit="1/s", within=(0.0, 1.0e4)),
        lambda simulation: simulation.parameters.rayleigh_mass,
        lambda simulation, value: simulation.set_damping(rayleigh_mass=value),
    )
    return found


def with_values(robot: RobotDescription, values: Mapping[str, float]) -> RobotDescription:
    """Return the robot with other values of its tunable parameters, by name.

    Raises:
        SoftSimError: a law does not allow them.
    """
    scene, bodies = robot.scene, []

    def select_values(owner: str, names: Mapping[str, float]) -> dict[str, float]:
        prefix = scene.parameter_prefix(owner)
        return {name: values[f"{prefix}{name}"] for name in names if f"{prefix}{name}" in values}

    for body in scene.bodies:
        of_parts = {each.name: select_values(f"{body.name}.{each.name}", each.values) for each in body.parts}
        changed = replace(
            body,
            material=body.material.with_values(**select_values(body.name, body.material.values)),
            layers=tuple(each.with_values(of_parts[each.name]) for each in body.layers),
            fibres=tuple(each.with_values(of_parts[each.name]) for each in body.fibres),
            regions=tuple(each.with_values(of_parts[each.name]) for each in body.regions),
        )
        bodies.append(changed)
    solver = replace(
        scene.solver,
        rayleigh_stiffness=values.get("rayleigh_stiffness", scene.solver.rayleigh_stiffness),
        rayleigh_mass=values.get("rayleigh_mass", scene.solver.rayleigh_mass),
    )
    return robot.with_scene(bodies=tuple(bodies), solver=solver)


class TuningParameters(ParameterChanges):
    """ROS parameters of the running physics; checked as a whole, then written between two steps.

    Args:
        write: Runs a change of the simulation in the physics thread.
    """

    def __init__(self, node: Node, write: Callable[[Callable[[Simulation], None]], object]) -> None:
        self._write = write
        self._robot: RobotDescription | None = None
        self._tunables: dict[str, Tunable] = {}
        super().__init__(node)

    def declare(self, robot: RobotDescription, *, uses_overrides: bool = True) -> RobotDescription:
        """Declare the parameters of a robot instead of those of the previous one.

        Args:
            robot: The robot.
            uses_overrides: Whether values from the start of the node override those of the file.

        Returns:
            The robot with the values that the parameters have now.

        Raises:
            ParameterError: a value given at the start is out of range; no parameter of the physics is left.
        """
        with self._quietly():
            for name in self._tunables:
                self._node.undeclare_parameter(name)
            self._tunables, values = {}, {}
            for name, tunable in tunables(robot).items():
                values[name] = declare_value(
                    self._node, name, tunable.value, tunable.about, overridable=uses_overrides
                )
                self._tunables[name] = tunable
        self._robot = with_values(robot, values)
        return self._robot

    def tune(self, simulation: Simulation) -> None:
        """Write the values that differ from the robot's file to a simulation built from that file."""
        for name, tunable in self._tunables.items():
            value = float(self._node.get_parameter(name).value)
            if value != tunable.value:
                tunable.write(simulation, value)

    def read(self, simulation: Simulation) -> dict[str, float]:
        """Return the values that a simulation uses, by name."""
        return {name: tunable.read(simulation) for name, tunable in self._tunables.items()}

    def _values(self, changes: Sequence[Parameter]) -> dict[str, float]:
        """Return the values that are to be checked or applied, by name."""
        values = {}
        for change in () if self._is_quiet else changes:
            tunable = self._tunables.get(change.name)
            if tunable is not None:
                values[change.name] = check_value(change.name, change.value, tunable.value, tunable.about)
        return values

    def _check_changes(self, changes: Sequence[Parameter]) -> None:
        values = self._values(changes)
        if values and self._robot is not None:
            if SCENE & {change.name for change in changes}:
                raise ParameterError("set robot or overrides first, and then what the physics has there")
            with_values(self._robot, values)

    def _post_set(self, changes: list[Parameter]) -> None:
        values = self._values(changes)
        if not values or self._robot is None:
            return
        self._robot = with_values(self._robot, values)
        writers = {name: self._tunables[name].write for name in values}

        def write(simulation: Simulation) -> None:
            for name, value in values.items():
                writers[name](simulation, value)

        self._write(write)


def _of_material(
    number: int, owner: str, name: str
) -> tuple[Callable[[Simulation], float], Callable[[Simulation, float], None]]:
    def read(simulation: Simulation) -> float:
        return simulation.parameters.materials[number][name]

    def write(simulation: Simulation, value: float) -> None:
        simulation.set_material(owner, **{name: value})

    return read, write
