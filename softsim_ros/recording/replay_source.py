"""What a replay sends and when: whole bags, or the commands in them with the simulator's start and reset."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Iterator
from operator import attrgetter
from typing import NamedTuple

from softsim_ros.recording.bag import Bag, RawMessage
from softsim_ros.recording.errors import BagError

COMMAND_TOPICS = ("position_controller/commands", "joint_trajectory")
BASE_SHIFT = "base_shift"


class Event(NamedTuple):
    """Something a replay does at a time of the bag.

    Attributes:
        stamp_ns: When, in [ns] since 1970.
        message: What to publish; None calls a service.
        service: Trigger service of the simulator to call: "start" or "reset"; empty for messages.
    """

    stamp_ns: int
    message: RawMessage | None
    service: str = ""


def command_topics(bag: Bag) -> list[str]:
    """The bag's topics that move joints.

    Raises:
        BagError: it has none.
    """
    topics = [topic for topic in map(bag.topic, COMMAND_TOPICS) if bag.counts.get(topic)]
    if not topics:
        raise BagError(bag.path, f"holds no commands (topics {', '.join(map(bag.topic, COMMAND_TOPICS))})")
    return topics


def messages(bag: Bag, topics: list[str], since_ns: int) -> Iterator[Event]:
    """Messages from `since_ns` on, after the newest earlier one of each latched topic."""
    for topic in topics:
        offered = bag.offered_qos(topic)
        if since_ns > bag.begin_ns and offered is not None and offered.durability.name == "TRANSIENT_LOCAL":
            for newest in deque(bag.raw_messages([topic], before_ns=since_ns), maxlen=1):
                yield Event(since_ns, newest)
    for message in bag.raw_messages(topics, since_ns=since_ns):
        yield Event(message.stamp_ns, message)


def commands(bag: Bag, since_ns: int) -> Iterator[Event]:
    """Commands, and the start animations and resets that the shift of the bases tells of."""
    sent = messages(bag, command_topics(bag), since_ns)
    calls = (event for event in _simulator_calls(bag) if event.stamp_ns >= since_ns)
    return heapq.merge(sent, calls, key=attrgetter("stamp_ns"))


def _simulator_calls(bag: Bag) -> Iterator[Event]:
    before = 0.0
    for stamp, message in bag.messages(bag.topic(BASE_SHIFT)):
        if (message.data == 0.0) != (before == 0.0):
            yield Event(stamp, None, "start" if before == 0.0 else "reset")
        before = float(message.data)
