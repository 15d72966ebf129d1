"""Observe the ROS graph: topics, messages as text, rates."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterator, Sequence
from statistics import fmean
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from softsim_core.base import known_names
from softsim_node import ending, environment, matching_qos, ros_process
from softsim_ros.cli import CommandError
from softsim_ros.client import FIRST_WITHIN_S, OTHERS_S, running_robots
from softsim_ros.messages import load_message


def message_text(message: Any, limit: int | None = 12, indent: str = "") -> str:
    """Return the fields of a ROS message as text, one per line after `indent`, nested messages indented.

    `limit` is the longest array that is printed completely; None prints all.
    """
    lines = []
    for name in message.get_fields_and_field_types():
        value = getattr(message, name)
        if hasattr(value, "get_fields_and_field_types"):
            lines += [f"{indent}{name}:", message_text(value, limit, f"{indent}  ")]
        elif isinstance(value, Sequence) and value and hasattr(value[0], "get_fields_and_field_types"):
            shown = value if limit is None else value[:limit]
            texts = (message_text(item, limit, f"{indent}    ") for item in shown)
            lines += [f"{indent}{name}:", *(f"{indent}  - {text.lstrip()}" for text in texts)]
            if len(shown) < len(value):
                lines.append(f"{indent}  ... {len(value)} in all")
        else:
            lines.append(f"{indent}{name}: {_value_text(value, limit)}")
    return "\n".join(lines)


def _value_text(value: Any, limit: int | None) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, (str, bytes)) or not hasattr(value, "__len__"):
        return str(value)
    shown = value if limit is None else value[:limit]
    text = ", ".join(_value_text(item, limit) for item in shown)
    rest = f", ... {len(value)} in all" if len(shown) < len(value) else ""
    return f"[{text}{rest}]"


TURN_S = 0.1
REPORT_S = 1.0
QUEUE_DEPTH = 10
"""Queue length of messages to print."""

OWN_NAME = "_softsim_topics"


def where() -> str:
    """Return a description of the part of the ROS network that this process can reach."""
    domain = os.environ.get("ROS_DOMAIN_ID", "0")
    return f"domain {domain}, discovery range {environment.requested_range(os.environ)}"


@contextlib.contextmanager
def observer() -> Iterator[Node]:
    """Create a node that only observes; Ctrl-C inside the `with` block ends it quietly."""
    with ros_process():
        node = Node(OWN_NAME, enable_rosout=False, start_parameter_services=False)
        try:
            yield node
        finally:
            node.destroy_node()


def topic_rows(
    node: Node, shown: Callable[[str], bool] = lambda name: True
) -> list[tuple[str, str, int, int]]:
    """Return topics as rows of name, types, publisher count, subscriber count, once discovery has settled.

    Discovery has settled when nothing new has appeared for as many turns as announcements take to repeat. The
    process counts its own turns and not the time, because it receives nothing while it is paused.

    Args:
        node: Node that observes the graph.
        shown: Returns whether a topic counts, given its name.
    """

    def look() -> list[tuple[str, str, int, int]]:
        rows = []
        for name, types in node.get_topic_names_and_types():
            ends = node.get_publishers_info_by_topic(name), node.get_subscriptions_info_by_topic(name)
            others = [sum(info.node_name != OWN_NAME for info in infos) for infos in ends]
            if shown(name) and any(others):
                rows.append((name, ", ".join(types), others[0], others[1]))
        return sorted(rows)

    rows, quiet = look(), 0
    while not ending.asked and quiet * TURN_S < (OTHERS_S if rows else FIRST_WITHIN_S):
        _turn(node)
        newer = look()
        rows, quiet = newer, quiet + 1 if newer == rows else 0
    return rows


def follow(node: Node, topic: str, *, show: bool, count: int | None, limit: int | None, wait_s: float) -> int:
    """Print a topic's messages, or its rate once per second, until Ctrl-C or `count` lines.

    Args:
        node: The observing node.
        topic: Name; without a leading slash also below the namespace of a running robot.
        show: True prints messages, False rates.
        count: Number of lines; None: until Ctrl-C.
        limit: Longest array that is printed completely; None: any.
        wait_s: Longest wait for a publisher in [s].

    Returns:
        Exit code.

    Raises:
        CommandError: no node publishes the topic, or its type is not known here.
    """
    found = _find_publishers(node, topic, wait_s)
    if found is None:
        if not ending.asked:
            rows = [row[0] for row in topic_rows(node)]
            hint = known_names(topic, rows, lists_all="softsim topics")
            raise CommandError(f"no node publishes {topic} in {where()}; {hint}")
        return 1
    topic, infos = found
    type_name = infos[0].topic_type
    try:
        message_class = load_message(type_name)
    except (ImportError, AttributeError) as error:
        raise CommandError(f"the type {type_name} of {topic} is not installed here") from error
    receiver = _Echo(limit) if show else Rate()
    raw = not show  # a rate needs no decoding
    node.create_subscription(message_class, topic, receiver, matching_qos(infos, QUEUE_DEPTH), raw=raw)
    while not ending.asked and (count is None or receiver.lines < count):
        _turn(node)
        receiver.report()
    return 0


def _find_publishers(node: Node, topic: str, wait_s: float) -> tuple[str, list[Any]] | None:
    """Return the full name of a topic and its publishers.

    Return None if no node publishes it within the wait in [s].
    """
    deadline = time.monotonic() + wait_s
    while not ending.asked:
        spaces = [] if topic.startswith("/") else ["", *(each.rstrip("/") for each in running_robots(node))]
        for name in [f"{space}/{topic}" for space in spaces] or [topic]:
            if infos := node.get_publishers_info_by_topic(name):
                return name, infos
        if time.monotonic() >= deadline:
            return None
        _turn(node)
    return None


def _turn(node: Node) -> None:
    with contextlib.suppress(ExternalShutdownException):
        rclpy.spin_once(node, timeout_sec=TURN_S)


class _Echo:
    """Prints each message."""

    def __init__(self, limit: int | None) -> None:
        self.limit, self.lines = limit, 0

    def __call__(self, message: Any) -> None:
        self.lines += 1
        print(f"{message_text(message, self.limit)}\n---", flush=True)

    def report(self) -> None: ...


class Rate:
    """Counts messages and prints their rate once per second, by a `clock` in [s]."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.clock, self.lines, self.carried_count = clock, 0, 0
        self.times: list[float] = []
        self.sizes: list[int] = []
        self.since = clock()

    def __call__(self, message: bytes) -> None:
        """Count a message."""
        self.times.append(self.clock())
        self.sizes.append(len(message))

    def report(self) -> None:
        """Print a line when a second has passed."""
        now = self.clock()
        if now - self.since < REPORT_S:
            return
        gaps = [later - sooner for sooner, later in zip(self.times, self.times[1:], strict=False)]
        if gaps:
            text = (
                f"{1.0 / fmean(gaps):.1f} Hz  gaps {1e3 * min(gaps):.1f} to {1e3 * max(gaps):.1f} ms  "
                f"{fmean(self.sizes):.0f} bytes a message"
            )
        else:
            count = "one" if len(self.times) > self.carried_count else "no"
            text = f"{count} message in the last second"
        print(text, flush=True)
        self.lines += 1
        self.times, self.sizes, self.since = self.times[-1:], self.sizes[-1:], now
        self.carried_count = len(self.times)  # the next gap begins with the last message of this second
