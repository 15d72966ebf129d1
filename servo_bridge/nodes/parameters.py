"""Parameters of the bridge node, the files that they name, and the driver that they describe."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeVar, get_args

from servo_bridge.driver import (
    FASTEST_HZ,
    SLOWEST_HZ,
    EStop,
    MotionSettings,
    ServoDriver,
    calibrated_robot,
    file_for,
)
from servo_bridge.protocols import AUTO, TiltReading, names
from softsim_core.base import ConfigError, SoftSimError, listing, shorten
from softsim_core.scene import RobotDescription
from softsim_node import ParameterError, declare, parameter, parameter_probe

Loaded = TypeVar("Loaded")


def load_robot(name: str) -> RobotDescription:
    """Load a robot by name or file.

    Raises:
        SoftSimError: it cannot be read.
    """
    from softsim_core.scene import load_scene  # costs imports: only when needed

    return read_named("robot", name, lambda: load_scene(name))


def read_named(parameter: str, value: str, read: Callable[[], Loaded]) -> Loaded:
    """Call `read` and return its result; turn any unexpected error into a message about the parameter."""
    try:
        return read()
    except SoftSimError:
        raise
    except Exception as error:  # a user of that name, a name too long, nesting too deep, a robot's own code
        raise ConfigError(
            "servo_bridge",
            f"parameter {parameter}",
            f"{shorten(value)!r} cannot be read ({type(error).__name__}: {shorten(str(error), 100)});"
            " give a name or a readable file",
        ) from error


Source = Literal["joint_states", "commands", "joint_commands"]
Autostart = Literal["none", "configure", "activate"]

# Parameters that take effect at the next configure and are refused while the node is configured
FIXED_WHILE_CONFIGURED = frozenset(("source", "rate", "open_wait_s", "baud_rate"))
_TIMES = MotionSettings()


@dataclass(frozen=True, slots=True, kw_only=True)
class BridgeSettings:
    """Parameters of the node."""

    robot: str = parameter("tripod", "Robot: a name from configs/robots, or the path of its file", fixed=True)
    port: str = parameter(
        "",
        "Serial port, e.g. /dev/ttyACM0 or a link, or udp:HOST:PORT; empty: the one board that is plugged in",
        fixed=True,
    )
    source: Source = parameter(
        "joint_states",
        "What the servos follow: joint_states (the simulator's), commands (position_controller/commands) or"
        " joint_commands (by name, as ros2_control sends them)",
        choices=get_args(Source),
    )
    autostart: Autostart = parameter(
        "none",
        "State to reach at the start: none, configure (open the port) or activate (send); repeated until"
        " reached",
        choices=get_args(Autostart),
        fixed=True,
    )
    protocol: str = parameter(
        AUTO,
        f"What the board speaks: {AUTO} (as the robot's file says, else found out), or its name:"
        f" {listing(names())}, or one that the robot's Python file registers",
        fixed=True,
    )
    baud_rate: int = parameter(
        0,
        "Bits per second; 0: the protocol's own, else the board's from the robot's file",
        unit="bit/s",
        within=(0, 2_000_000),
    )
    calibration: str = parameter(
        "auto",
        "File of the servos' calibration (softsim calibrate-servos); auto: the one in the user's"
        " configuration, where it exists; empty: none",
        fixed=True,
    )
    imu_frame: str = parameter("", "Frame of the topic imu; empty: <frame_prefix>effector")
    frame_prefix: str = parameter("", "Stands before the robot's frames; from its namespace", fixed=True)
    rate: float = parameter(
        0.0,
        f"Packets per second: {SLOWEST_HZ:g} to {FASTEST_HZ:g}; 0: the robot's file says",
        unit="Hz",
        within=(0.0, FASTEST_HZ),
    )
    open_wait_s: float = parameter(
        2.5, "Quiet time after opening: most boards reset when opened", unit="s", within=(0.0, 60.0)
    )
    hold_timeout: float = parameter(
        _TIMES.hold_timeout_s, "Hold still without a command for this long", unit="s", within=(0.02, 3600.0)
    )
    rest_timeout: float = parameter(
        _TIMES.rest_timeout_s,
        "Go slowly to rest without a command for this long",
        unit="s",
        within=(0.02, 3600.0),
    )
    rest_speed: float = parameter(
        _TIMES.rest_speed, "Speed of the slow motion to rest", unit="rad/s", within=(0.01, 10.0)
    )
    settle_timeout: float = parameter(
        4.0, "Longest motion to the safe pose at the end", unit="s", within=(0.1, 60.0)
    )
    avoid_byte_100: bool = parameter(
        True,
        "Send no byte 100 where the protocol can help it: coming first after a reset amid a packet, 100"
        " makes the boot loader erase the firmware",
    )
    relax_at_end: bool = parameter(
        True, "Switch the pulses off when the port is closed with the servos at rest, where the board can"
    )

    @property
    def motion(self) -> MotionSettings:
        """Timing of hold and rest."""
        return MotionSettings(
            hold_timeout_s=self.hold_timeout, rest_timeout_s=self.rest_timeout, rest_speed=self.rest_speed
        )


def robot_namespace(node_name: str) -> str:
    """Return the namespace for the robot of a node's command line; empty if the robot cannot be loaded.

    The error is reported by configure.

    Raises:
        ParameterError: a value given at the start is not allowed.
    """
    with parameter_probe(node_name) as probe:
        name = declare(probe, BridgeSettings()).robot
    try:
        return load_robot(name).name
    except SoftSimError:
        return ""


def check(
    settings: BridgeSettings, changed: frozenset[str] = frozenset(), *, configured: bool = False
) -> None:
    """Check the values after the parameters `changed` were set, for what their ranges cannot express.

    Raises:
        ParameterError: the values cannot be used while the bridge is, or is not, `configured`.
    """
    fixed = sorted(changed & FIXED_WHILE_CONFIGURED)
    if configured and fixed:
        raise ParameterError(
            f"{listing(fixed)} is fixed while the bridge is configured; call its lifecycle cleanup first"
        )
    if 0.0 < settings.rate < SLOWEST_HZ:
        raise ParameterError(
            f"parameter rate = {settings.rate:g} is refused; give 0.0, or {SLOWEST_HZ:g} to {FASTEST_HZ:g} Hz"
        )


def assemble(
    settings: BridgeSettings,
    scene: RobotDescription | None,
    e_stop: EStop,
    on_tilt: Callable[[TiltReading], None],
) -> tuple[ServoDriver, str]:
    """Create the driver that the settings describe, for the robot `scene`; None loads the one that they name.

    Returns:
        The driver, and the file of its servos' calibration (empty without one).

    Raises:
        SoftSimError: robot or calibration cannot be read, or the robot has no board that fits the settings.
    """
    robot = load_robot(settings.robot) if scene is None else scene
    calibration = read_named(
        "calibration", settings.calibration, lambda: file_for(settings.calibration, robot.name)
    )
    if calibration is not None:
        file = calibration
        robot = read_named("calibration", str(file), lambda: calibrated_robot(robot, file))
    driver = ServoDriver(
        robot,
        settings=settings.motion,
        rate=settings.rate or None,
        avoid_byte_100=settings.avoid_byte_100,
        protocol=settings.protocol,
        baud_rate=settings.baud_rate or None,
        on_tilt=on_tilt,
        e_stop=e_stop,
    )
    return driver, str(calibration or "")
