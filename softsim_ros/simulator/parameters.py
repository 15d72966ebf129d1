"""The simulator's parameters but those of the physics: which exist and what they allow."""

from __future__ import annotations

from dataclasses import dataclass, replace

from softsim_core.scene.robot import RobotDescription
from softsim_node.parameters import ParameterError, parameter
from softsim_ros.robot_node import RobotSettings
from softsim_ros.simulator.snapshot_folder import default_folder

BACKENDS = ("auto", "numba", "scipy")
OUT_OF_RANGE = ("clamp", "refuse")
SLOWEST = 1.0e-3
"""Least speed but 0, in simulated seconds per wall second; at slower ones a step comes after minutes."""


@dataclass(frozen=True, kw_only=True)
class SceneSettings(RobotSettings):
    """Which scene is simulated: what has to be known before the defaults of the others are."""

    robot: str = parameter(
        "tripod", "Robot or scene: a name such as tripod; at the start also the path of a .yaml or .py file"
    )
    overrides: str = parameter(
        "",
        "Values laid over the scene's file, as YAML text: 'gravity: [0, 0, -1.6]'; it begins anew with them",
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
    watch: bool = parameter(False, "Load the scene anew whenever one of its files is saved", fixed=True)
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
        """As a robot's file says.

        Args:
            robot: The robot.
            first: What was asked for.
            snapshot: Name of its snapshot.
        """
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
        """The robot with the limits of its commands as the parameters say."""
        refuses = self.out_of_range == "refuse"
        commands = replace(
            robot.commands,
            enforce_limits=self.enforce_limits,
            out_of_range="refuse" if refuses else "clamp",
        )
        return replace(robot, commands=commands)


def check_speed(speed: float) -> None:
    """Raise where a simulation would stand still: slower than SLOWEST, but not 0.

    Raises:
        ParameterError: it would.
    """
    if 0.0 < speed < SLOWEST:
        raise ParameterError(f"parameter speed = {speed:g} is refused; allowed: 0.0, {SLOWEST:g} to 1000")
