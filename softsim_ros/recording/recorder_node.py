"""The node `recorder`: every topic of a robot into a rosbag2 file, as it comes."""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool
from std_srvs.srv import SetBool

from servo_bridge.state_topics import StateTopics
from softsim_core import load_scene
from softsim_core.errors import SoftSimError
from softsim_ros.messages.types import load_message
from softsim_ros.recording.bag_writer import BagWriter
from softsim_ros.recording.errors import RecordingError
from softsim_ros.recording.qos import bag_qos
from softsim_ros.recording.selection import SHARED, Selection
from softsim_ros.runtime import (
    ClosableNode,
    declare_number,
    declare_switch,
    declare_text,
    parameter_probe,
    run_node,
)

NODE_NAME = "recorder"
LOOK_PERIOD_S = 0.25
"""New topics and publishers are looked for this often, in [s]."""

FLUSH_PERIOD_S = 1.0
SILENCE_S = 5.0
"""Without any message for this long a sentence says so, in [s]."""

DEPTH = 1000
"""Messages of a topic that may wait while the disk is slow."""


class Recorder(ClosableNode):
    """Records while it is enabled; each time into a new bag.

    Args:
        context: rclpy context; None takes the default one.
        namespace: Whose topics; None takes the parameter `robot`, `-r __ns:=/other` wins over both.
        parameter_overrides: Values at start, over those of the command line.
        news: Gets sentences about begin and end; None writes them to the log.

    Attributes:
        failure: Why the last recording ended before its time; None while all is well.

    Raises:
        RecordingError: the bag cannot be made.
    """

    def __init__(
        self,
        *,
        context: Context | None = None,
        namespace: str | None = None,
        parameter_overrides: Sequence[Parameter] = (),
        news: Callable[[str], None] | None = None,
    ) -> None:
        overrides = list(parameter_overrides)
        if namespace is None:
            namespace = namespace_of(_requested_robot(context, overrides))
        super().__init__(NODE_NAME, context=context, namespace=namespace, parameter_overrides=overrides)
        self.failure: RecordingError | None = None
        self._news: Callable[[str], None] = news or self.get_logger().info
        self._bag: BagWriter | None = None
        self._heard: dict[str, tuple[Any, tuple[object, ...]]] = {}
        self._unknown: set[str] = set()
        try:
            self._declare()
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            self.create_service(SetBool, "~/enable", self._on_enable)
            self.create_timer(LOOK_PERIOD_S, self._look, clock=steady)
            self.create_timer(FLUSH_PERIOD_S, self._flush, clock=steady)
            if self._autostart:
                self.begin()
            self._state_topics = StateTopics(self, {"~/enabled": (Bool, lambda: Bool(data=self.recording))})
        except BaseException:
            self.close()
            raise

    def _declare(self) -> None:
        self._robot = _declare_robot(self)
        self._out = declare_text(
            self, "out", "", "Folder of the bag, which must not exist; empty: ROBOT_DATE-TIME here"
        )
        chosen = declare_text(
            self, "topics", "", "Topics to record, separated by spaces; empty: all of the robot"
        )
        self._selection = Selection(self.get_namespace(), chosen.split())
        self._size_limit = 1e6 * declare_number(
            self, "size_limit", 0.0, "End at this size in MB; 0.0: no limit", 0.0, 1e9
        )
        self._time_limit = declare_number(
            self, "time_limit", 0.0, "End this long after the first message, in s; 0.0: no limit", 0.0, 1e9
        )
        self._autostart = declare_switch(
            self, "autostart", True, "Begin at once, without a call of ~/enable", read_only=True
        )

    @property
    def recording(self) -> bool:
        """Whether a bag is open."""
        return self._bag is not None

    def begin(self) -> str:
        """Open a new bag; returns a sentence.

        Raises:
            RecordingError: it cannot be made, or one is open.
        """
        if self._bag is not None:
            raise RecordingError(f"recording to {self._bag.folder} already; end it first")
        folder = Path(self._out or f"{self._robot}_{datetime.now():%Y-%m-%d_%H-%M-%S}").expanduser()
        notes = {"robot": self._robot, "namespace": self.get_namespace()}
        self._bag, self.failure = BagWriter(folder, notes), None
        self._since, self._silent, self._said_silent = time.monotonic(), True, False
        self._look()
        return self._say(f"recording to {folder}")

    def end(self) -> str:
        """Close the bag; returns a sentence with what it holds.

        Raises:
            RecordingError: none is open, or it cannot be written to its end.
        """
        if self._bag is None:
            raise RecordingError("nothing is being recorded")
        bag, self._bag = self._bag, None
        for subscription, _ in self._heard.values():
            self.destroy_subscription(subscription)
        self._heard.clear()
        bag.close()
        size = sum(file.stat().st_size for file in bag.folder.iterdir())
        return self._say(
            f"{bag.folder}: {bag.count} messages on {len(bag.topics)} topics, {bag.duration_s:.1f} s, "
            f"{1e-6 * size:.1f} MB"
        )

    def close(self) -> None:
        """Close the bag, destroy the node; a second call does nothing."""
        try:
            if self._bag is not None:
                self.end()
        except RecordingError as error:
            self._failed(error)
        finally:
            self.destroy_node()

    # --- topics ---------------------------------------------------------------------------------------

    def _look(self) -> None:
        """Subscribe to topics that are new, or whose publishers now need another subscription."""
        if self._bag is None:
            return
        for topic, types in self.get_topic_names_and_types():
            if self._selection.wants(topic) and types:
                self._hear(self._bag, topic, types[0])
        waited = time.monotonic() - self._since
        if self._silent and waited > SILENCE_S and not self._said_silent:
            self._said_silent = True
            self._say(f"nothing is published in {self.get_namespace()} yet; waiting")
        if 0.0 < self._time_limit <= waited and not self._silent:
            self._end_at(f"the time limit of {self._time_limit:g} s is reached")

    def _hear(self, bag: BagWriter, topic: str, type_name: str) -> None:
        if topic in self._unknown:
            return
        profiles = [info.qos_profile for info in self.get_publishers_info_by_topic(topic)]
        reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in profiles)
        latched = bool(profiles) and all(
            profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in profiles
        )
        if topic in self._heard and (not profiles or self._heard[topic][1] == (reliable, latched)):
            return
        try:
            message_type = load_message(type_name)
        except (ImportError, AttributeError):
            message_type = None
        if message_type is None or not bag.knows(type_name):
            self._unknown.add(topic)
            self.get_logger().warning(f"{topic} is not recorded: the type {type_name} is not known here")
            return
        qos = QoSProfile(
            depth=DEPTH,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )
        if profiles:
            bag.add_topic(topic, type_name, [bag_qos(profile) for profile in profiles])
        if topic in self._heard:
            self.destroy_subscription(self._heard[topic][0])
        callback = partial(self._on_message, topic, type_name)
        subscription = self.create_subscription(message_type, topic, callback, qos, raw=True)
        self._heard[topic] = (subscription, (reliable, latched))

    def _on_message(self, topic: str, type_name: str, data: bytes) -> None:
        if self._bag is None:
            return
        if self._silent and topic not in SHARED:
            self._since, self._silent = time.monotonic(), False
        try:
            self._bag.add_topic(topic, type_name)
            self._bag.write(topic, time.time_ns(), data)
        except RecordingError as error:
            self._failed(error)

    # --- limits and ends ------------------------------------------------------------------------------

    def _flush(self) -> None:
        if self._bag is None:
            return
        try:
            self._bag.flush()
        except RecordingError as error:
            self._failed(error)
            return
        if 0.0 < self._size_limit <= self._bag.size:
            self._end_at(f"the size limit of {1e-6 * self._size_limit:g} MB is reached")

    def _end_at(self, reason: str) -> None:
        self._say(reason)
        try:
            self.end()
        except RecordingError as error:
            self._failed(error)

    def _failed(self, error: RecordingError) -> None:
        self._bag, self.failure = None, error
        with suppress(Exception):  # on the way out there may be no log any more
            self.get_logger().error(str(error))

    def _say(self, sentence: str) -> str:
        with suppress(Exception):
            self._news(sentence)
        return sentence

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        try:
            response.success, response.message = True, self.begin() if request.data else self.end()
        except SoftSimError as error:
            response.success, response.message = False, str(error)
        self._state_topics.refresh()
        return response


def namespace_of(robot: str) -> str:
    """The namespace of a robot's nodes: the name in its file; of one that is not known here the name itself.

    Raises:
        RecordingError: neither a known robot nor a name that can be a namespace.
    """
    try:
        return load_scene(robot).name
    except SoftSimError as error:
        if not re.fullmatch(r"[A-Za-z_]\w*(/[A-Za-z_]\w*)*", robot, re.ASCII):
            raise RecordingError(f"no robot to record: {error}") from error
        return robot


def _declare_robot(node: Node) -> str:
    return declare_text(node, "robot", "tripod", "Whose topics: name of the robot, and of its namespace")


def _requested_robot(context: Context | None, overrides: list[Parameter]) -> str:
    """The parameter `robot`, needed before the node: it names the namespace."""
    with parameter_probe(NODE_NAME, context=context, parameter_overrides=overrides) as probe:
        return _declare_robot(probe)


def main(args: Sequence[str] | None = None) -> int:
    """Run the recorder as a process; returns the exit code."""
    return run_node(Recorder, args)


if __name__ == "__main__":
    sys.exit(main())
