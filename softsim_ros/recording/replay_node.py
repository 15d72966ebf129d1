"""The node `replay`: publishes a bag's messages again, byte for byte, with their original timing."""

from __future__ import annotations

import heapq
import math
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from operator import attrgetter
from typing import NamedTuple

from rclpy.duration import Duration
from rclpy.executors import Executor
from rclpy.publisher import Publisher
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger

from softsim_node import (
    STATE_TOPICS,
    GuardedNode,
    LiveParameters,
    StateTopics,
    answering,
    ending,
    parameter,
    serve_once,
)
from softsim_ros.messages import load_message
from softsim_ros.nodes.simulator import RateGate
from softsim_ros.recording.bag import Bag, RawMessage
from softsim_ros.recording.errors import BagError, RecordingError
from softsim_ros.recording.recorder_node import SHARED, publisher_qos


class ReplayClock:
    """Bag time that runs at `speed` from a position on.

    Args:
        now: Steady clock in [s].
        speed: Seconds of the bag per second of the clock, > 0.

    Attributes:
        paused: Whether it stands still.
    """

    def __init__(self, now: float, speed: float = 1.0) -> None:
        self._since, self._position, self._speed = now, 0.0, speed
        self.paused = False

    def position(self, now: float) -> float:
        """Return the bag time in [s]."""
        return self._position + (0.0 if self.paused else (now - self._since) * self._speed)

    def wait_s(self, position: float, now: float) -> float:
        """Return the time until a bag time is reached: <= 0 if it has passed, infinite while paused."""
        return math.inf if self.paused else (position - self.position(now)) / self._speed

    def set_speed(self, speed: float, now: float) -> None:
        """Continue from here at another speed."""
        self.seek(self.position(now), now)
        self._speed = speed

    def seek(self, position: float, now: float) -> None:
        """Continue from another bag time."""
        self._position, self._since = position, now

    def pause(self, paused: bool, now: float) -> None:
        """Pause, or continue."""
        self.seek(self.position(now), now)
        self.paused = paused


COMMAND_TOPICS = ("position_controller/commands", "joint_trajectory")
BASE_SHIFT = "base_shift"


class Event(NamedTuple):
    """A message to publish at a time in [ns] since 1970, or the simulator's service "start" or "reset"."""

    stamp_ns: int
    message: RawMessage | None
    service: str = ""


def command_topics(bag: Bag) -> list[str]:
    """Return the bag's topics that move joints.

    Raises:
        BagError: it has none.
    """
    topics = [topic for topic in map(bag.topic, COMMAND_TOPICS) if bag.counts.get(topic)]
    if not topics:
        raise BagError(bag.path, f"holds no commands (topics {', '.join(map(bag.topic, COMMAND_TOPICS))})")
    return topics


def messages(bag: Bag, topics: list[str], since_ns: int) -> Iterator[Event]:
    """Yield messages from `since_ns` on, after the newest earlier one of each latched topic."""
    for topic in topics:
        offered = bag.offered_qos(topic)
        if since_ns > bag.begin_ns and offered is not None and offered.durability.name == "TRANSIENT_LOCAL":
            for newest in deque(bag.raw_messages([topic], before_ns=since_ns), maxlen=1):
                yield Event(since_ns, newest)
    for message in bag.raw_messages(topics, since_ns=since_ns):
        yield Event(message.stamp_ns, message)


def commands(bag: Bag, since_ns: int) -> Iterator[Event]:
    """Yield commands, and the start animations and resets that the base shift shows."""
    sent = messages(bag, command_topics(bag), since_ns)
    calls = (event for event in _simulator_calls(bag) if event.stamp_ns >= since_ns)
    return heapq.merge(sent, calls, key=attrgetter("stamp_ns"))


def _simulator_calls(bag: Bag) -> Iterator[Event]:
    before = 0.0
    for stamp, message in bag.messages(bag.topic(BASE_SHIFT)):
        if (message.data == 0.0) != (before == 0.0):
            yield Event(stamp, None, "start" if before == 0.0 else "reset")
        before = float(message.data)


NODE_NAME = "replay"
DISCOVERY_S = 1.5
"""Time in [s] for the discovery of other nodes before anything is reported about them."""

ROBOT_TOPICS = ("joint_states", "effector_pose", "mesh/points")
"""Topics that only one node may publish: a simulator, or a replay of everything."""

RIVAL_PERIOD_S = 0.5
"""Period in [s] of the search for nodes that publish the same topics, while a bag plays."""

LISTENER_DEADLINE_S = 15.0
LOOK_PERIOD_S = 0.05
"""Longest interval in [s] between two services of callbacks."""


@dataclass(frozen=True, kw_only=True)
class ReplaySettings:
    """Values of the parameters."""

    speed: float = parameter(1.0, "Seconds of the bag per second", within=(0.001, 1000.0))


class Replay(GuardedNode):
    """Publishes a bag.

    Args:
        bag: Bag to play, open.
        namespace: Namespace in which to play it; None takes the one in which it was recorded.
        commands_only: Publish only what moves joints, for a running simulator; otherwise everything.
        speed: Seconds of the bag per second; the parameter `speed` changes it.
        start_s: Length of the beginning to skip in [s]; the newest latched messages are published anyway.

    Raises:
        BagError: nothing to play, or messages of a type that is not installed.
    """

    def __init__(
        self,
        bag: Bag,
        *,
        namespace: str | None = None,
        commands_only: bool = False,
        speed: float = 1.0,
        start_s: float = 0.0,
    ) -> None:
        target = bag.namespace if namespace is None else namespace
        super().__init__(NODE_NAME, namespace=target)
        self._bag, self._commands_only = bag, commands_only
        self._since_ns = bag.begin_ns + round(1e9 * start_s)
        self._playhead = ReplayClock(time.monotonic())
        self._serves, self._looks = RateGate(LOOK_PERIOD_S), RateGate(RIVAL_PERIOD_S)
        self.sent = 0
        try:
            self._topics = command_topics(bag) if commands_only else whole_topics(bag)
            if start_s > bag.duration_s or not self._topics:
                reason = f"has nothing after {start_s:g} s; it is {bag.duration_s:.1f} s long"
                raise BagError(bag.path, reason)
            self._live = LiveParameters(self, ReplaySettings(speed=speed), apply=self._change_speed)
            self._playhead.set_speed(self._live.values.speed, time.monotonic())
            self._types = {topic: self._message_type(topic) for topic in self._topics}
            self._senders: dict[str, Publisher] = {}
            services = ("start", "reset")
            self._simulator = {name: self.create_client(Trigger, f"simulator/{name}") for name in services}
            self.create_service(SetBool, "~/pause", answering(self._pause))
            facts = {"replay/paused": lambda: Bool(data=self._playhead.paused)}
            self._state_topics = StateTopics(self, facts)
        except BaseException:
            self.destroy_node()
            raise

    def target(self, topic: str) -> str:
        """Return the topic for a recorded one: this node's namespace replaces the recorded one."""
        recorded = self._bag.namespace.rstrip("/") + "/"
        if topic.startswith(recorded) and topic not in SHARED:
            return f"{self.get_namespace().rstrip('/')}/{topic[len(recorded) :]}"
        return topic

    def prepare(self, executor: Executor, *, reset: bool = False) -> None:
        """Create the publishers; with commands, wait until somebody listens.

        Args:
            executor: Serves this node.
            reset: Call the simulator's reset before anything is sent.

        Raises:
            RecordingError: another node publishes the same topics, or nobody takes the commands.
        """
        self._serve(executor, DISCOVERY_S)
        self._refuse_rivals()
        for topic in self._topics:
            qos = publisher_qos(self._bag.offered_qos(topic))
            self._senders[topic] = self.create_publisher(self._types[topic], self.target(topic), qos)
        if self._commands_only:
            first = self._senders[self._topics[0]]
            if not self._serve(executor, LISTENER_DEADLINE_S, lambda: first.get_subscription_count() > 0):
                raise RecordingError(
                    f"no node subscribes to {first.topic_name}; start the robot: softsim up {self._bag.robot}"
                )
        else:
            self._serve(executor, DISCOVERY_S)
        if reset and not self._call("reset", executor):
            name = self._simulator["reset"].srv_name
            raise RecordingError(f"no answer from {name}; is a simulator running?")

    def play(self, executor: Executor) -> None:
        """Publish everything once, from the start; return early if the process is to end.

        Raises:
            RecordingError: another node has begun to publish the same topics.
        """
        self._playhead.seek(0.0, time.monotonic())
        if self._commands_only:
            events = commands(self._bag, self._since_ns)
        else:
            events = messages(self._bag, self._topics, self._since_ns)
        for event in events:
            if not self._wait_for(1e-9 * (event.stamp_ns - self._since_ns), executor):
                return
            self._send(event, executor)
        for publisher in self._senders.values():
            publisher.wait_for_all_acked(Duration(seconds=5))

    def _wait_for(self, position: float, executor: Executor) -> bool:
        """Serve callbacks until a bag time is reached; return False if the process is to end."""
        while True:
            now = time.monotonic()
            wait = self._playhead.wait_s(position, now)
            if wait <= 0.0 and not self._serves.passes(now):
                return True
            serve_once(executor, min(max(wait, 0.0), LOOK_PERIOD_S))
            if ending.asked or not executor.context.ok():
                return False
            if self._looks.passes(time.monotonic()):
                self._refuse_rivals()

    def _send(self, event: Event, executor: Executor) -> None:
        if event.message is not None:
            self._senders[event.message.topic].publish(event.message.data)
            self.sent += 1
        elif self._simulator[event.service].service_is_ready():
            self._call(event.service, executor)  # it must be done before the next event

    def _call(self, service: str, executor: Executor) -> bool:
        client = self._simulator[service]
        if not self._serve(executor, LISTENER_DEADLINE_S, client.service_is_ready):
            return False
        future = client.call_async(Trigger.Request())
        return self._serve(executor, LISTENER_DEADLINE_S, future.done)

    def _serve(self, executor: Executor, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Serve callbacks until a condition is true; return False if the time is over first."""
        end = time.monotonic() + seconds
        while not until():
            if time.monotonic() > end or ending.asked or not executor.context.ok():
                return False
            serve_once(executor, LOOK_PERIOD_S)
        return True

    def _refuse_rivals(self) -> None:
        """Raise RecordingError if another node publishes the robot's state during a whole replay."""
        if self._commands_only:
            return
        for topic in map(self._bag.topic, ROBOT_TOPICS):
            target = self.target(topic)
            if self.count_publishers(target) > (topic in self._senders):
                raise RecordingError(
                    f"{target} is published by another node; end that one, replay elsewhere (--namespace "
                    f"{self.get_namespace().strip('/')}_replay), or only the commands (--commands)"
                )

    def _message_type(self, topic: str) -> type:
        type_name = self._bag.topics[topic]
        try:
            return load_message(type_name)
        except (ImportError, AttributeError):
            reason = f"{topic} has the type {type_name}, which is not installed here"
            raise BagError(self._bag.path, reason) from None

    def _pause(self, paused: bool) -> str:
        self._playhead.pause(paused, time.monotonic())
        self._state_topics.refresh()
        return "paused" if paused else "playing"

    def _change_speed(self, _: frozenset[str], settings: ReplaySettings) -> None:
        self._playhead.set_speed(settings.speed, time.monotonic())


def whole_topics(bag: Bag) -> list[str]:
    """Return the topics of a whole replay.

    The state topics of nodes are left out, since those nodes do not run.
    """
    left_out = {bag.topic(name) for name in STATE_TOPICS}
    return [topic for topic in bag.topics if topic not in left_out]
