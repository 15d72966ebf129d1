"""The sensors of a robot on its topics: which exist, where they are mounted, what a message contains."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from geometry_msgs.msg import PoseArray, PoseStamped
from rclpy.node import Node
from sensor_msgs.msg import Imu

from softsim_core.base import Array, SoftSimError, Vector, listing
from softsim_core.lab.identification import EFFECTOR, SensorDescription
from softsim_node import matching_qos
from softsim_ros.excitation.readings import Readings


class ExcitationError(SoftSimError, RuntimeError):
    """A robot cannot be measured, or not to the end; data recorded before are preserved."""


POSE, MARKERS, IMU = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseArray", "sensor_msgs/msg/Imu"
TYPES: Final = {POSE: PoseStamped, MARKERS: PoseArray, IMU: Imu}

SIMULATED: Final = "effector_pose"
"""Topic with the simulator's effector pose."""

NOT_MEASURED: Final = frozenset(
    {
        SIMULATED,
        "effector_goal",
        "effector_reference",
        "inverse_controller/model_pose",
        "bodies/poses",
        "frames",
    }
)
"""Pose topics in a robot's namespace that no sensor measures."""

FOUND_WITHIN_S: Final = 10.0
SETTLED_S: Final = 1.5
"""Time in [s] of the search for sensors that were not named."""

DEPTH: Final = 500
IMU_FIELDS: Final = ("qx", "qy", "qz", "qw", "wx", "wy", "wz", "ax", "ay", "az")


class SensorChoice(NamedTuple):
    """A topic to record, and the mount of each of its points: a robot's frame, or a body's point in [m]."""

    topic: str
    places: tuple[str | Vector, ...] = ()


def sensor_choice(text: str) -> SensorChoice:
    """Parse TOPIC, or TOPIC=PLACE,PLACE... with places that are frames or points X:Y:Z in [m].

    Raises:
        ExcitationError: the text has another form.
    """
    topic, _, places = text.partition("=")
    if not re.fullmatch(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", topic, re.ASCII):
        raise ExcitationError(f"sensor {text!r}: write TOPIC or TOPIC=PLACE,..., such as markers=effector")
    return SensorChoice(topic, tuple(_place(each, text) for each in places.split(",") if each))


def _place(text: str, whole: str) -> str | Vector:
    if ":" not in text:
        return text
    try:
        x, y, z = map(float, text.split(":"))
    except ValueError as error:
        raise ExcitationError(
            f"sensor {whole!r}: a point is X:Y:Z in m of the robot at rest, such as 0.01:0:0.03"
        ) from error
    return x, y, z


@dataclass(frozen=True, slots=True, eq=False)
class Sensor:
    """A subscribed topic.

    Attributes:
        topic: Its name as it was given.
        kind: Its type.
        readings: Its messages; positions in [m], three numbers per point, or the numbers of an IMU.
        described: Its points as a data set describes them; empty for an IMU.
    """

    topic: str
    kind: str
    readings: Readings
    described: tuple[SensorDescription, ...]

    @property
    def columns(self) -> list[str]:
        """Names of its numbers, in order."""
        if self.kind == IMU:
            return [f"{_word(self.topic)}_{field}" for field in IMU_FIELDS]
        return [column for each in self.described for column in each.columns]

    def in_units(self, numbers: Array) -> Array:
        """Return numbers (k, n) in the units of the columns."""
        return numbers if self.kind == IMU else 1e3 * numbers


def subscribe_sensors(
    node: Node, choices: Sequence[SensorChoice], unknown: Callable[[str], None]
) -> list[Sensor]:
    """Subscribe to the chosen sensors, else to those that exist, else to the simulator's.

    Args:
        node: In the robot's namespace; it spins.
        choices: Requested sensors.
        unknown: Called with messages about topics that exist but cannot be used.

    Raises:
        ExcitationError: there is no such topic, it is of another type, or the mounts of its points are
            unknown.
    """
    sensors = [_subscribe_sensor(node, each) for each in choices] if choices else _find_sensors(node, unknown)
    if all(each.kind == IMU for each in sensors):
        raise ExcitationError(
            f"{listing(each.topic for each in sensors)}: an IMU measures no position; name a topic of "
            "PoseStamped or PoseArray, too"
        )
    names = [described.name for each in sensors for described in each.described]
    if len(set(names)) < len(names):
        raise ExcitationError(f"two sensors would both be called one of {listing(sorted(set(names)))}")
    return sensors


def _find_sensors(node: Node, unknown: Callable[[str], None]) -> list[Sensor]:
    """Return existing sensors that publish; if none measures a position, add the simulator's."""
    sensors = [_subscribe_sensor(node, each) for each in _find_choices(node, unknown)]
    end = time.monotonic() + SETTLED_S
    while not all(len(each.readings) for each in sensors) and time.monotonic() < end:
        time.sleep(0.05)
    for each in sensors:
        if not len(each.readings):
            unknown(f"{each.topic} is left out: it says nothing")
    sensors = [each for each in sensors if len(each.readings)]
    if all(each.kind == IMU for each in sensors):
        sensors.append(_subscribe_sensor(node, SensorChoice(SIMULATED)))
    return sensors


def _find_choices(node: Node, unknown: Callable[[str], None]) -> list[SensorChoice]:
    prefix = node.get_namespace().rstrip("/") + "/"
    found: dict[str, str] = {}
    end = time.monotonic() + SETTLED_S
    while time.monotonic() < end:
        for name, types in node.get_topic_names_and_types():
            topic = name.removeprefix(prefix)
            measured = name.startswith(prefix) and topic not in NOT_MEASURED and types[0] in TYPES
            if measured and node.count_publishers(name):
                found[topic] = types[0]
        time.sleep(0.05)
    for topic, kind in list(found.items()):
        if kind == MARKERS:
            del found[topic]
            unknown(f"{topic} is left out: say what its points sit on, --sensor {topic}=PLACE,PLACE...")
    return [SensorChoice(topic) for topic in sorted(found)]


def _subscribe_sensor(node: Node, choice: SensorChoice) -> Sensor:
    full = node.resolve_topic_name(choice.topic)
    end = time.monotonic() + FOUND_WITHIN_S
    while not (infos := node.get_publishers_info_by_topic(full)):
        if time.monotonic() > end:
            raise ExcitationError(
                f"no node publishes {full} within {FOUND_WITHIN_S:g} s; start the sensor's driver, or name "
                "another topic with --sensor (softsim topics lists them)"
            )
        time.sleep(0.05)
    kind = infos[0].topic_type
    if kind not in TYPES:
        raise ExcitationError(
            f"{full} is of type {kind}; sensors are {listing(each.split('/')[-1] for each in TYPES)}"
        )
    places = choice.places or (() if kind == MARKERS else (EFFECTOR,))
    if kind == MARKERS and not places:
        raise ExcitationError(
            f"{full} has points on the robot; say what each sits on: --sensor {choice.topic}=PLACE,PLACE..., "
            "with frames of the robot or points X:Y:Z in m"
        )
    if kind == POSE and len(places) != 1:
        raise ExcitationError(f"{full} is one pose, and {len(places)} places are given for it")
    described = () if kind == IMU else _describe_sensors(choice.topic, places)
    readings = Readings(full, _numbers(kind, len(places)))
    node.create_subscription(TYPES[kind], full, readings, matching_qos(infos, DEPTH))
    return Sensor(choice.topic, kind, readings, described)


def _describe_sensors(topic: str, places: Sequence[str | Vector]) -> tuple[SensorDescription, ...]:
    word, lines = _word(topic), []
    for k, place in enumerate(places):
        name = word if len(places) == 1 else f"{word}_{k}"
        x, y, z = (f"{name}_{axis}_mm" for axis in "xyz")
        where = {"at": place} if isinstance(place, str) else {"place": place}
        lines.append(SensorDescription(name=name, columns=(x, y, z), unit="mm", **where))
    return tuple(lines)


def _word(topic: str) -> str:
    return topic.strip("/").replace("/", "_")


def _numbers(kind: str, count: int) -> Callable[[Any], Sequence[float]]:
    """Return the function that reads the numbers of a message: of an IMU, or of `count` positions."""

    def numbers(message: Any) -> Sequence[float]:
        if kind == IMU:
            q, w, a = message.orientation, message.angular_velocity, message.linear_acceleration
            return q.x, q.y, q.z, q.w, w.x, w.y, w.z, a.x, a.y, a.z
        places = [each.position for each in ([message.pose] if kind == POSE else message.poses)]
        if len(places) != count:  # a marker was lost, and it is unknown which
            return ()
        return [value for place in places for value in (place.x, place.y, place.z)]

    return numbers
