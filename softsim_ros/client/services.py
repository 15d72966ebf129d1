"""Non-blocking service calls, and the log of the robot's nodes."""

from __future__ import annotations

import time
import warnings
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from rcl_interfaces.msg import Log
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import SetBool

from softsim_node import EVERY_ONE, latched_qos

LENGTH: Final = 200
"""Largest number of stored lines."""


@dataclass(frozen=True, slots=True)
class LogLine:
    """A line of the log.

    Attributes:
        time_s: Time of the message, in [s] since 1970.
        level: 10, 20, 30, 40, 50 for debug, info, warning, error, fatal.
        source: Name of the logger without the robot's namespace: "simulator", "simulator.scene".
        text: The message.
    """

    time_s: float
    level: int
    source: str
    text: str


class RobotLog:
    """Follows `/rosout` for the nodes of the node's namespace, including earlier messages.

    Attributes:
        lines: Newest last.
        count: Number of lines since the start.
    """

    def __init__(self, node: Node) -> None:
        self.lines: deque[LogLine] = deque(maxlen=LENGTH)
        self.count = 0
        self._space = node.get_namespace()
        node.create_subscription(Log, "/rosout", self._on_log, latched_qos(LENGTH))

    def add(self, line: LogLine) -> None:
        """Store one more line."""
        self.lines.append(line)
        self.count += 1

    def _on_log(self, message: Log) -> None:
        source = source_within(self._space, message.name)
        if source and message.level >= Log.INFO:
            stamp = message.stamp.sec + 1e-9 * message.stamp.nanosec
            self.add(LogLine(stamp, message.level, source, message.msg))


class Warnings:
    """Reports warnings and errors of the robot's other nodes, and lines printed by the scene's own code.

    Args:
        node: The node whose executor delivers the messages; its own lines are left out.
    """

    def __init__(self, node: Node, say: Callable[[str], None]) -> None:
        self._space, self._name, self._say = node.get_namespace(), node.get_name(), say
        node.create_subscription(Log, "/rosout", self._on_log, EVERY_ONE)

    def _on_log(self, message: Log) -> None:
        source = source_within(self._space, message.name)
        node, _, child = source.partition(".")
        by_scene = child == "scene"
        if node and node != self._name and (by_scene or (not child and message.level >= Log.WARN)):
            self._say(f"{child or node}: {' '.join(message.msg.split())}")


def source_within(namespace: str, logger: str) -> str:
    """Return a logger's name without the robot's namespace, such as "simulator.scene".

    Return an empty string if it is not the robot's.
    """
    prefix = f"{namespace.strip('/').replace('/', '.')}.".lstrip(".")
    return logger[len(prefix) :] if logger.startswith(prefix) else ""


ANSWER_WITHIN_S: Final = 8.0
"""Default time in [s] after which a call is aborted; opening a port may take a few seconds."""

Answered = Callable[[Any], None]
"""Called with the response, or with None if the call failed or was aborted."""


class Outcome(NamedTuple):
    """Outcome of an action: whether it was done, and a message about it."""

    success: bool
    message: str

    @property
    def sentence(self) -> str:
        """The message; former name, until release 0.3.0."""
        former = "Outcome.sentence is now Outcome.message; release 0.3.0 removes the former name"
        warnings.warn(former, DeprecationWarning, stacklevel=2)
        return self.message


Done = Callable[[Outcome], None]
"""Called once, from the node's executor, with the outcome of an action."""


def ignore_outcome(_: Outcome) -> None:
    """Ignore the outcome."""


def report(end: Outcome, say: Callable[[str], None], done: Done) -> None:
    """Report the message of an outcome to the user, if it has one, and pass the outcome on."""
    if end.message:
        say(end.message)
    done(end)


class AsyncService:
    """Non-blocking client of one service.

    Args:
        name: Service name, relative to the node's namespace.
        answer_within_s: Time in [s] after which a call without a response is aborted.
    """

    def __init__(self, node: Node, kind: Any, name: str, answer_within_s: float = ANSWER_WITHIN_S) -> None:
        self.name, self._answer_within_s = name, answer_within_s
        self.full_name = str(node.resolve_service_name(name))
        self._client = node.create_client(kind, name)
        self._future: Future | None = None
        self._answered: Answered | None = None
        self._called_at = 0.0

    @property
    def is_there(self) -> bool:
        """Whether a server has been found."""
        return bool(self._client.service_is_ready())

    @property
    def is_busy(self) -> bool:
        """Whether a call is in progress."""
        return self._future is not None

    def call(self, request: Any, now: float, answered: Answered) -> None:
        """Send a request; `answered` is called later from the executor. Call only while not busy."""
        self._called_at, self._answered = now, answered
        self._future = self._client.call_async(request)
        self._future.add_done_callback(self._on_done)

    def expire(self, now: float) -> None:
        """Abort a call that has waited too long; `now` is a steady clock in [s]."""
        if self._future is not None and now - self._called_at > self._answer_within_s:
            self._client.remove_pending_request(self._future)
            self._future.cancel()
            self._finish(None)

    def _on_done(self, future: Future) -> None:
        if future is self._future:  # otherwise a response to a call aborted before
            self._finish(None if future.exception() is not None else future.result())

    def _finish(self, response: Any) -> None:
        answered, self._answered, self._future = self._answered, None, None
        if answered is not None:
            answered(response)


class Request(AsyncService):
    """Client of a service whose response has success and message; reports the outcome to the user.

    Args:
        who: Name of the other node in messages, such as "simulator".
    """

    def __init__(
        self,
        node: Node,
        kind: Any,
        name: str,
        who: str,
        say: Callable[[str], None],
        answer_within_s: float = ANSWER_WITHIN_S,
    ) -> None:
        super().__init__(node, kind, name, answer_within_s)
        self._who, self._say = who, say

    def ask(
        self, request: Any, done: Done = ignore_outcome, on_success: Callable[[], str] = lambda: ""
    ) -> None:
        """Send a request.

        Args:
            request: The request.
            done: Called once with the outcome, also if nothing could be sent.
            on_success: Called before `done`; returns the message to use if the response has none.
        """

        def handle_response(response: Any) -> None:
            if response is None:
                end = Outcome(False, f"{self._who}: no answer from {self.name}")
            elif not response.success:
                reason = response.message or "refused without a reason"
                end = Outcome(False, f"{self._who}: {reason}")
            else:
                own = on_success()
                end = Outcome(True, f"{self._who}: {response.message}" if response.message else own)
            report(end, self._say, done)

        if self.is_busy:
            problem = f"{self._who}: still busy with {self.name}"
        elif not self.is_there:
            problem = f"{self._who} is not running (no service {self.full_name})"
        else:
            self.call(request, time.monotonic(), handle_response)
            return
        report(Outcome(False, problem), self._say, done)


class Switch(Request):
    """Client of a SetBool service; no request is lost if the user acts fast.

    Requests made during a call are sent after it; of several requests only the newest is sent.
    """

    def __init__(self, node: Node, name: str, who: str, say: Callable[[str], None]) -> None:
        super().__init__(node, SetBool, name, who, say)
        self._asked: bool | None = None
        self._next: tuple[bool, Done, Callable[[], str]] | None = None

    def opposite(self, present: bool) -> bool:
        """Return the opposite of the pending request, or of `present` if there is none."""
        return not (present if self._asked is None else self._asked)

    def set(self, on: bool, done: Done, on_success: Callable[[], str]) -> None:
        """Switch on or off; see `Request.ask` for the other arguments."""
        self._asked = on
        if self.is_busy:
            overtaken, self._next = self._next, (on, done, on_success)
            if overtaken is not None:
                overtaken[1](Outcome(False, f"{self._who}: a newer request came before the answer"))
            return

        def finish(end: Outcome) -> None:
            following, self._next = self._next, None
            if following is None:
                self._asked = None
            done(end)
            if following is not None:
                self.set(*following)

        self.ask(SetBool.Request(data=on), finish, on_success)
