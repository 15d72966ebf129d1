"""The calibration of one robot's own servos: a small YAML file that says how they are mounted.

    robot: tripod
    servos:
      - {joint: servo_0, zero_byte: 179, sign: 1, trim_deg: 2.0, byte_min: 62, byte_max: 178, rest_byte: 150}

The keys are those of the robot's file. Every key but `joint` may be left out and is then the robot's own; so
may a servo.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, TypeVar

from softsim_core.errors import ConfigError, SceneError
from softsim_core.file_writing import write_file
from softsim_core.scene.board import BusServo, Servo, ServoCalibration
from softsim_core.scene.generated import comment, scalar
from softsim_core.scene.robot import RobotDescription
from softsim_core.scene.yaml_source import read_yaml
from softsim_core.wrong_names import known_names

AnyServo = TypeVar("AnyServo", ServoCalibration, BusServo)


def default_file(robot: str) -> Path:
    """Where the calibration of a robot is kept: softsim/servos/<robot>.yaml in the person's configuration."""
    configuration = os.environ.get("XDG_CONFIG_HOME") or str(Path.home() / ".config")
    return Path(configuration) / "softsim" / "servos" / f"{robot}.yaml"


def file_for(choice: str, robot: str) -> Path | None:
    """The file that the parameter `calibration` means: a path, the default file where it exists, or none."""
    if choice == "auto":
        return default_file(robot) if default_file(robot).is_file() else None
    return Path(choice).expanduser() if choice else None


def load_calibration(file: Path, robot: str, servos: Sequence[AnyServo]) -> tuple[AnyServo, ...]:
    """The servos of a board with what the file says of them.

    Args:
        file: The calibration.
        robot: Name of the robot; the file of another one is refused.
        servos: The robot's own calibration, in packet order.

    Raises:
        ConfigError: unreadable file, unknown key or joint, a value that is not allowed.
    """
    data = read_yaml(file)
    for key in data:
        if key not in ("robot", "servos"):
            raise ConfigError(file, key, "is no key of a calibration; known: robot, servos")
    if data.get("robot") != robot:
        raise ConfigError(file, "robot", f"must be {robot}, not {data.get('robot')!r}; calibrate that robot")
    entries = data.get("servos")
    if not isinstance(entries, list):
        raise ConfigError(file, "servos", "must be a list of servos, each with joint and what differs")
    found = {servo.joint: servo for servo in servos}
    seen: set[str] = set()
    for index, entry in enumerate(entries):
        where = f"servos[{index}]"
        joint = entry.get("joint") if isinstance(entry, dict) else None
        if joint not in found:
            raise ConfigError(
                file, f"{where}.joint", f"{joint!r} drives no servo; {known_names(joint, found)}"
            )
        if joint in seen:
            raise ConfigError(file, f"{where}.joint", f"{joint} is given twice")
        seen.add(joint)
        found[joint] = _changed(found[joint], entry, file, where)
    return tuple(found[servo.joint] for servo in servos)


def calibrated_robot(robot: RobotDescription, file: Path) -> RobotDescription:
    """The robot with its board's servos as the file says.

    Raises:
        ConfigError: see `load_calibration`.
        SceneError: the robot has no board.
    """
    if robot.board is None:
        raise SceneError(f"robot {robot.name} has no servo board to calibrate")
    board = robot.board
    servos: tuple[Servo, ...]
    if board.bus_servos:
        servos = load_calibration(file, robot.name, board.bus_servos)
    else:
        servos = load_calibration(file, robot.name, board.hobby_servos)
    return replace(robot, board=replace(board, servos=servos))


def save_calibration(file: Path, robot: str, servos: Sequence[Servo]) -> None:
    """Write the file in one go: a reader, or a power cut, meets the old one or the new one, never half of it.

    Raises:
        ConfigError: it cannot be written.
    """
    head = comment(f"How the servos of {robot} are mounted; made by `softsim calibrate-servos {robot}`.")
    lines = [f"robot: {scalar(robot)}", "servos:"]
    for servo in servos:
        values = {**asdict(servo), "joint": scalar(servo.joint)}
        lines.append("  - {" + ", ".join(f"{key}: {value}" for key, value in values.items()) + "}")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        write_file(file, head + "\n".join(lines) + "\n")
    except OSError as error:
        raise ConfigError(file, "", f"cannot be written ({error.strerror or error})") from error


def _changed(servo: AnyServo, entry: dict[str, Any], file: Path, where: str) -> AnyServo:
    known = asdict(servo)
    for key, value in entry.items():
        if key not in known:
            raise ConfigError(file, f"{where}.{key}", f"is no key of a servo; {known_names(key, known)}")
        if key == "joint":
            continue
        number = isinstance(value, int | float) and not isinstance(value, bool)
        any_number = isinstance(known[key], float)
        if not number or not (any_number or isinstance(value, int)):
            wanted = "a number" if any_number else "a whole number"
            raise ConfigError(file, f"{where}.{key}", f"must be {wanted}, not {value!r}")
        if key == "sign" and value not in (1, -1):
            raise ConfigError(file, f"{where}.sign", f"must be 1 or -1, not {value}")
        if key == "trim_deg" and not -180.0 <= value <= 180.0:
            raise ConfigError(file, f"{where}.trim_deg", f"must be within -180..180, not {value}")
    try:
        return replace(servo, **entry)
    except SceneError as error:
        raise ConfigError(file, where, str(error)) from error
