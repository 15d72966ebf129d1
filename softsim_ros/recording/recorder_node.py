"""The node `recorder`: records every topic of a robot to a rosbag2 file, message by message."""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from std_msgs.msg import Bool
from std_srvs.srv import SetBool

from softsim_core import load_scene
from softsim_core.base import SoftSimError
from softsim_node import (
    GuardedNode,
    Program,
    StateTopics,
    answering,
    declare,
    matching_qos,
    parameter,
    parameter_probe,
    run_node,
    steady_timer,
)
from softsim_ros.messages import load_message
from softsim_ros.recording.bag_writer import BagWriter
from softsim_ros.recording.errors import RecordingError

FAST_DEPTH = 100
"""Queue length of replayed topics; a replay may be faster than the original publisher."""


def bag_qos(profile: QoSProfile) -> Qos:
    """Return a publisher's QoS profile in the form that a bag stores."""
    return Qos(
        QosHistory[profile.history.name],
        profile.depth,
        QosReliability[profile.reliability.name],
        QosDurability[profile.durability.name],
        _bag_time(profile.deadline),
        _bag_time(profile.lifespan),
        QosLiveliness[profile.liveliness.name],
        _bag_time(profile.liveliness_lease_duration),
        profile.avoid_ros_namespace_conventions,
    )


def publisher_qos(offered: Qos | None) -> QoSProfile:
    """Return the profile with which to republish a recorded topic; reliable if the bag stores none."""
    if offered is None:
        return QoSProfile(depth=10)
    best_effort = offered.reliability is QosReliability.BEST_EFFORT
    latched = offered.durability is QosDurability.TRANSIENT_LOCAL
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=max(offered.depth, 1) if latched else max(offered.depth, FAST_DEPTH),
        reliability=ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def _bag_time(duration: Duration) -> QosTime:
    return QosTime(*divmod(duration.nanoseconds, 1_000_000_000))


SHARED = ("/diagnostics", "/tf", "/tf_static", "/clock")
"""Topics that all robots share."""

LEFT_OUT = ("mesh/marker", "step_profile", "recorder/enabled", "scene/edit", "scene/proposal")
"""Topics that are recorded only on request.

`mesh/marker` is made from mesh/points at five times the size; `step_profile` contains each step ten times;
the others are the recorder's own state and edits of the scene's file.
"""


class Selection:
    """Topics to record: all of the robot and the shared ones, or named ones.

    Args:
        namespace: Namespace of the robot, such as "/tripod".
        names: Topics to take, absolute or below the namespace; none takes all but `LEFT_OUT`.
    """

    def __init__(self, namespace: str, names: Sequence[str] = ()) -> None:
        self._prefix = namespace.rstrip("/") + "/"
        self._names = {self.absolute(name) for name in names}
        self._left_out = {self.absolute(name) for name in LEFT_OUT}

    def absolute(self, name: str) -> str:
        """Return the full name of a topic."""
        return name if name.startswith("/") else self._prefix + name

    def wants(self, topic: str) -> bool:
        """Return whether a topic of the graph is recorded."""
        if self._names:
            return topic in self._names
        if "/_" in topic:  # hidden by ROS's convention, such as those of an action
            return False
        return topic in SHARED or (topic.startswith(self._prefix) and topic not in self._left_out)


NODE_NAME = "recorder"
LOOK_PERIOD_S = 0.25
"""Period in [s] of the search for new topics and publishers."""

FLUSH_PERIOD_S = 1.0
SILENCE_S = 5.0
"""Time in [s] without any message after which the recorder reports it."""

DEPTH = 1000
"""Queue length of a topic while the disk is slow."""


@dataclass(frozen=True, kw_only=True)
class RecorderSettings:
    """Values of the parameters."""

    robot: str = parameter("tripod", "Whose topics: name of the robot, and of its namespace", fixed=True)
    out: str = parameter(
        "", "Folder of the bag, which must not exist; empty: ROBOT_DATE-TIME here", fixed=True
    )
    topics: str = parameter("", "Topics to record, separated by spaces; empty: all of the robot", fixed=True)
    size_limit: float = parameter(
        0.0, "End at this size; 0.0: no limit", unit="MB", within=(0.0, 1e9), fixed=True
    )
    time_limit: float = parameter(
        0.0, "End this long after the first message; 0.0: no limit", unit="s", within=(0.0, 1e9), fixed=True
    )
    autostart: bool = parameter(True, "Begin at once, without a call of ~/enable", fixed=True)


class Recorder(GuardedNode):
    """Records while it is enabled, each time into a new bag.

    Args:
        context: rclpy context; None takes the default one.
        namespace: Namespace of the topics; None takes the parameter `robot`; `-r __ns:=/other` overrides
            both.
        parameter_overrides: Values at the start, which override those of the command line.
        news: Called with messages about begin and end; None writes them to the log.

    Attributes:
        failure: Why the last recording ended early; None if it did not.

    Raises:
        RecordingError: the bag cannot be created.
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
        if namespace is None:  # the parameter is needed before the node
            with parameter_probe(NODE_NAME, context=context, parameter_overrides=overrides) as probe:
                namespace = namespace_of(declare(probe, RecorderSettings()).robot)
        super().__init__(NODE_NAME, context=context, namespace=namespace, parameter_overrides=overrides)
        self.failure: RecordingError | None = None
        self._news: Callable[[str], None] = news or self.get_logger().info
        self._bag: BagWriter | None = None
        self._recorded_topics: dict[str, tuple[Any, tuple[object, ...]]] = {}
        self._unknown: set[str] = set()
        try:
            self._settings = declare(self, RecorderSettings())
            self._selection = Selection(self.get_namespace(), self._settings.topics.split())
            self.create_service(SetBool, "~/enable", answering(self._switch))
            steady_timer(self, LOOK_PERIOD_S, self._look)
            steady_timer(self, FLUSH_PERIOD_S, self._flush)
            if self._settings.autostart:
                self.begin()
            self._state_topics = StateTopics(self, {"recorder/enabled": lambda: Bool(data=self.recording)})
        except BaseException:
            self.close()
            raise

    @property
    def recording(self) -> bool:
        """Whether a bag is open."""
        return self._bag is not None

    def begin(self) -> str:
        """Open a new bag; return a message.

        Raises:
            RecordingError: it cannot be created, or one is open.
        """
        if self._bag is not None:
            raise RecordingError(f"recording to {self._bag.folder} already; end it first")
        robot = self._settings.robot
        folder = Path(self._settings.out or f"{robot}_{datetime.now():%Y-%m-%d_%H-%M-%S}").expanduser()
        notes = {"robot": robot, "namespace": self.get_namespace()}
        self._bag, self.failure = BagWriter(folder, notes), None
        self._since, self._silent, self._said_silent = time.monotonic(), True, False
        self._look()
        return self._say(f"recording to {folder}")

    def end(self) -> str:
        """Close the bag; return a message about its content.

        Raises:
            RecordingError: none is open, or it cannot be completed.
        """
        if self._bag is None:
            raise RecordingError("nothing is being recorded")
        self._take_what_waits()
        bag, self._bag = self._bag, None
        if bag is None:  # the disk is full
            raise self.failure or RecordingError("nothing is being recorded")
        for subscription, _ in self._recorded_topics.values():
            self.destroy_subscription(subscription)
        self._recorded_topics.clear()
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
            self._record_failure(error)
        finally:
            self.destroy_node()

    # --- topics ---------------------------------------------------------------------------------------

    def _look(self) -> None:
        """Subscribe to new topics, and to topics whose publishers now need another subscription."""
        if self._bag is None:
            return
        for topic, types in self.get_topic_names_and_types():
            if self._selection.wants(topic) and types:
                self._subscribe(self._bag, topic, types[0])
        waited = time.monotonic() - self._since
        if self._silent and waited > SILENCE_S and not self._said_silent:
            self._said_silent = True
            self._say(f"nothing is published in {self.get_namespace()} yet; waiting")
        limit = self._settings.time_limit
        if 0.0 < limit <= waited and not self._silent:
            self._end_at(f"the time limit of {limit:g} s is reached")

    def _subscribe(self, bag: BagWriter, topic: str, type_name: str) -> None:
        if topic in self._unknown:
            return
        publishers = self.get_publishers_info_by_topic(topic)
        qos = matching_qos(publishers, DEPTH)
        kind = (qos.reliability, qos.durability)
        if topic in self._recorded_topics and (not publishers or self._recorded_topics[topic][1] == kind):
            return
        message_type = None
        with suppress(ImportError, AttributeError):
            message_type = load_message(type_name)
        if message_type is None or not bag.knows(type_name):
            self._unknown.add(topic)
            self.get_logger().warning(f"{topic} is not recorded: the type {type_name} is not known here")
            return
        if publishers:
            bag.add_topic(topic, type_name, [bag_qos(each.qos_profile) for each in publishers])
        if topic in self._recorded_topics:
            self.destroy_subscription(self._recorded_topics[topic][0])
        callback = partial(self._on_message, topic, type_name)
        subscription = self.create_subscription(message_type, topic, callback, qos, raw=True)
        self._recorded_topics[topic] = (subscription, kind)

    def _on_message(self, topic: str, type_name: str, data: bytes) -> None:
        if self._bag is None:
            return
        if self._silent and topic not in SHARED:
            self._since, self._silent = time.monotonic(), False
        try:
            self._bag.add_topic(topic, type_name)
            self._bag.write(topic, time.time_ns(), data)
        except RecordingError as error:
            self._record_failure(error)

    def _take_what_waits(self) -> None:
        """Record the messages that wait for the executor."""
        for subscription, _ in self._recorded_topics.values() if self.context.ok() else ():
            for _ in range(DEPTH):
                taken = subscription.handle.take_message(subscription.msg_type, True)
                if taken is None:
                    break
                subscription.callback(taken[0])

    # --- limits and ends ------------------------------------------------------------------------------

    def _flush(self) -> None:
        if self._bag is None:
            return
        try:
            self._bag.flush()
        except RecordingError as error:
            self._record_failure(error)
            return
        limit = self._settings.size_limit
        if 0.0 < limit <= 1e-6 * self._bag.size:
            self._end_at(f"the size limit of {limit:g} MB is reached")

    def _end_at(self, reason: str) -> None:
        self._say(reason)
        try:
            self.end()
        except RecordingError as error:
            self._record_failure(error)

    def _record_failure(self, error: RecordingError) -> None:
        self._bag, self.failure = None, error
        with suppress(Exception):  # during shutdown there may be no log any more
            self.get_logger().error(str(error))

    def _say(self, message: str) -> str:
        with suppress(Exception):
            self._news(message)
        return message

    def _switch(self, on: bool) -> str:
        try:
            return self.begin() if on else self.end()
        finally:
            self._state_topics.refresh()


def namespace_of(robot: str) -> str:
    """Return the namespace of a robot's nodes: the name in its file, or `robot` if it is not known here.

    Raises:
        RecordingError: neither a known robot nor a name that can be a namespace.
    """
    try:
        return load_scene(robot).name
    except SoftSimError as error:
        if not re.fullmatch(r"[A-Za-z_]\w*(/[A-Za-z_]\w*)*", robot, re.ASCII):
            raise RecordingError(f"no robot to record: {error}") from error
        return robot


PROGRAM = Program(
    name="recorder",
    about="Records a robot's topics into a rosbag2 file.",
    settings=(RecorderSettings(),),
)

main = partial(run_node, PROGRAM, lambda _: Recorder())
"""Run as a process with the words of its command line; return the exit code."""

if __name__ == "__main__":
    sys.exit(main())
