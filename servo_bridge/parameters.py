"""Parameters of the bridge node: names, ranges, and the typed values read from them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, cast, get_args

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from servo_bridge.driver import FASTEST_HZ, SLOWEST_HZ
from servo_bridge.named_files import load_robot
from servo_bridge.protocols import AUTO, names
from servo_bridge.safety import MotionSettings
from servo_bridge.wording import shortened
from softsim_core.errors import ConfigError, SoftSimError, listing

Source = Literal["joint_states", "commands", "joint_commands"]
Autostart = Literal["none", "configure", "activate"]

FIXED_WHILE_CONFIGURED = (
    "robot",
    "port",
    "source",
    "rate",
    "open_wait_s",
    "protocol",
    "baud_rate",
    "calibration",
)
"""Parameters that take effect at the next configure and are refused while the node is configured."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BridgeSettings:
    """Values of the bridge's parameters; see `declare` for their meaning and units."""

    robot: str
    port: str
    source: Source
    protocol: str
    baud_rate: int
    calibration: str
    relax_at_end: bool
    imu_frame: str
    frame_prefix: str
    autostart: Autostart
    rate: float
    open_wait_s: float
    avoid_byte_100: bool
    settle_timeout: float
    motion: MotionSettings


def robot_namespace(node_name: str = "servo_bridge") -> str:
    """Namespace for the robot of a node's command line; empty where it is unknown (configure says why)."""
    node = Node(node_name, start_parameter_services=False, enable_rosout=False)
    try:
        name = declare_robot(node)
    finally:
        node.destroy_node()
    try:
        return load_robot(name).name
    except SoftSimError:
        return ""


def prefix_of(namespace: str) -> str:
    """What stands before the robot's frames, such as "left/": its namespace and a slash; nothing for /."""
    name = namespace.strip("/")
    return f"{name}/" if name else ""


def declare_robot(node: Node) -> str:
    """Declare and return which robot a node is for."""
    about = "Robot: a name from configs/robots, or the path of its file."
    return str(node.declare_parameter("robot", "tripod", ParameterDescriptor(description=about)).value)


def declare(node: Node) -> None:
    """Declare every parameter with its description and range."""
    times = MotionSettings()

    def text(
        name: str, default: str, description: str, *, allowed: str = "", read_only: bool = False
    ) -> None:
        node.declare_parameter(
            name,
            default,
            ParameterDescriptor(description=description, additional_constraints=allowed, read_only=read_only),
        )

    def number(name: str, default: float, low: float, high: float, description: str) -> None:
        limits = FloatingPointRange(from_value=low, to_value=high, step=0.0)
        node.declare_parameter(
            name, default, ParameterDescriptor(description=description, floating_point_range=[limits])
        )

    declare_robot(node)
    text("port", "", "Serial port, e.g. /dev/ttyACM0 or a link; empty: the one board that is plugged in.")
    text(
        "source",
        "joint_states",
        "What the servos follow: joint_states (the simulator's), commands (position_controller/commands) or"
        " joint_commands (by name, as ros2_control sends them).",
        allowed=listing(get_args(Source)),
    )
    text(
        "autostart",
        "none",
        "How far to go unasked: none, configure (open the port) or activate (send); tried until it works.",
        allowed=listing(get_args(Autostart)),
        read_only=True,
    )
    text(
        "protocol",
        AUTO,
        f"What the board speaks: {AUTO} (as the robot's file says, else found out), or its name.",
        allowed=f"{listing((AUTO, *names()))}, or one that the robot's Python file registers",
    )
    node.declare_parameter(
        "baud_rate",
        0,
        ParameterDescriptor(
            description="Bits a second; 0: the protocol's own, else the board's from the robot's file.",
            integer_range=[IntegerRange(from_value=0, to_value=2_000_000, step=1)],
        ),
    )
    text(
        "calibration",
        "auto",
        "File of the servos' calibration (softsim calibrate-servos); auto: the one in the person's"
        " configuration, where it exists; empty: none.",
    )
    text("imu_frame", "", "Frame of the topic imu; empty: <frame_prefix>effector.")
    text(
        "frame_prefix",
        prefix_of(node.get_namespace()),
        "Stands before the names of the robot's frames in headers.",
        read_only=True,
    )
    number(
        "rate",
        0.0,
        0.0,
        FASTEST_HZ,
        f"Packets a second in [Hz]: {SLOWEST_HZ:g} to {FASTEST_HZ:g}; 0: the robot's file says.",
    )
    number("open_wait_s", 2.5, 0.0, 60.0, "Quiet time in [s] after opening: most boards reset when opened.")
    number(
        "hold_timeout",
        times.hold_timeout_s,
        0.02,
        3600.0,
        "Hold still without a command for this long, in [s].",
    )
    number(
        "rest_timeout",
        times.rest_timeout_s,
        0.02,
        3600.0,
        "Go slowly to rest without one for this long, in [s].",
    )
    number("rest_speed", times.rest_speed, 0.01, 10.0, "Speed of the slow way to rest in [rad/s].")
    number("settle_timeout", 4.0, 0.1, 60.0, "Longest ramp to the safe pose on the way out, in [s].")
    node.declare_parameter(
        "avoid_byte_100",
        True,
        ParameterDescriptor(
            description="Send no byte 100 where the protocol can help it: coming first after a reset amid a"
            " packet, 100 makes the boot loader erase the firmware."
        ),
    )
    node.declare_parameter(
        "relax_at_end",
        True,
        ParameterDescriptor(
            description="Switch the pulses off when the port is closed with the servos at rest, where the"
            " board can."
        ),
    )


def read(node: Node) -> BridgeSettings:
    """The present values.

    Raises:
        ConfigError: a text parameter is none of the allowed words, or a number cannot be used.
    """

    def word(name: str, allowed: tuple[str, ...]) -> str:
        value = str(node.get_parameter(name).value)
        if value not in allowed:
            raise ConfigError(
                "servo_bridge", f"parameter {name}", f"{shortened(value)!r} is none of: {listing(allowed)}"
            )
        return value

    def number(name: str) -> float:
        value = float(node.get_parameter(name).value)
        if problem := _number_problem(name, value):
            raise ConfigError("servo_bridge", f"parameter {name}", problem)
        return value

    return BridgeSettings(
        robot=str(node.get_parameter("robot").value),
        port=str(node.get_parameter("port").value),
        source=cast(Source, word("source", get_args(Source))),
        protocol=str(node.get_parameter("protocol").value),
        baud_rate=int(node.get_parameter("baud_rate").value),
        calibration=str(node.get_parameter("calibration").value),
        relax_at_end=bool(node.get_parameter("relax_at_end").value),
        imu_frame=str(node.get_parameter("imu_frame").value),
        frame_prefix=str(node.get_parameter("frame_prefix").value),
        autostart=cast(Autostart, word("autostart", get_args(Autostart))),
        rate=number("rate"),
        open_wait_s=number("open_wait_s"),
        avoid_byte_100=bool(node.get_parameter("avoid_byte_100").value),
        settle_timeout=number("settle_timeout"),
        motion=MotionSettings(
            hold_timeout_s=number("hold_timeout"),
            rest_timeout_s=number("rest_timeout"),
            rest_speed=number("rest_speed"),
        ),
    )


def refusal(changes: list[Parameter], configured: bool) -> str:
    """Why a change of parameters is refused, in one sentence; empty when it is allowed."""
    for change in changes:
        if configured and change.name in FIXED_WHILE_CONFIGURED:
            return f"{change.name} is fixed while the bridge is configured; call its lifecycle cleanup first"
        if change.name == "source" and change.value not in get_args(Source):
            return f"source {shortened(str(change.value))} is none of: {listing(get_args(Source))}"
        if isinstance(change.value, float) and (problem := _number_problem(change.name, change.value)):
            return f"{change.name} {problem}"
    return ""


def _number_problem(name: str, value: float) -> str:
    """Why a number cannot be used, in words that follow its name, where its range cannot say it."""
    if math.isnan(value):
        return "nan is refused; give a number"
    if name == "rate" and 0.0 < value < SLOWEST_HZ:
        return f"{value:g} is refused; give 0, or {SLOWEST_HZ:g} to {FASTEST_HZ:g} Hz"
    return ""
