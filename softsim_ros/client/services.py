"""Services called without ever blocking: one call at a time each, given up after a while."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Final, NamedTuple

from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import SetBool

ANSWER_WITHIN_S: Final = 8.0
"""Default time in [s] until a call is given up; a port may take a few seconds to open."""

Answered = Callable[[Any], None]
"""Called with the response, or with None when the call failed or was given up."""


class Outcome(NamedTuple):
    """How an action ended: whether it was done, and a sentence about it."""

    success: bool
    sentence: str


Done = Callable[[Outcome], None]
"""Called once, from the node's executor, with the end of an action."""


def unheeded(_: Outcome) -> None:
    """Nobody waits for this end."""


class AsyncService:
    """One service of another node.

    Args:
        node: The node whose executor delivers the answers.
        kind: Service type.
        name: Service name, relative to the node's namespace.
        answer_within_s: Time in [s] after which a call without an answer is given up.
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
        """A server has been found."""
        return bool(self._client.service_is_ready())

    @property
    def is_busy(self) -> bool:
        """A call is under way."""
        return self._future is not None

    def call(self, request: Any, now: float, answered: Answered) -> None:
        """Send a request; `answered` is called later from the executor. Only while not busy."""
        self._called_at, self._answered = now, answered
        self._future = self._client.call_async(request)
        self._future.add_done_callback(self._on_done)

    def expire(self, now: float) -> None:
        """Give up a call that has waited too long; `now` is a steady clock in [s]."""
        if self._future is not None and now - self._called_at > self._answer_within_s:
            self._client.remove_pending_request(self._future)
            self._future.cancel()
            self._finish(None)

    def _on_done(self, future: Future) -> None:
        if future is self._future:  # else an answer to a call given up before
            self._finish(None if future.exception() is not None else future.result())

    def _finish(self, response: Any) -> None:
        answered, self._answered, self._future = self._answered, None, None
        if answered is not None:
            answered(response)


class Request:
    """A service that answers success and a sentence, and tells a person how it went.

    Args:
        node: The node whose executor delivers the answers.
        kind: Service type, whose response has `success` and `message`.
        name: Service name, relative to the node's namespace.
        who: The other node in words, such as "simulator".
        say: Called with a sentence for the person.
        answer_within_s: Time in [s] after which a call without an answer is given up.
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
        self._service, self._who, self._say = AsyncService(node, kind, name, answer_within_s), who, say

    @property
    def is_there(self) -> bool:
        """A server has been found."""
        return self._service.is_there

    @property
    def is_busy(self) -> bool:
        """A call is under way."""
        return self._service.is_busy

    def expire(self, now: float) -> None:
        """Give up a call that has waited too long; `now` is a steady clock in [s]."""
        self._service.expire(now)

    def ask(self, request: Any, done: Done = unheeded, on_success: Callable[[], str] = lambda: "") -> None:
        """Send a request.

        Args:
            request: What is sent.
            done: Called once with the end, also where nothing could be asked.
            on_success: Called before that; returns what is said where the answer brings no sentence.
        """
        service = self._service

        def answered(response: Any) -> None:
            if response is None:
                end = Outcome(False, f"{self._who}: no answer from {service.name}")
            elif not response.success:
                reason = response.message or "refused without a reason"
                end = Outcome(False, f"{self._who}: {reason}")
            else:
                own = on_success()
                end = Outcome(True, f"{self._who}: {response.message}" if response.message else own)
            self._end(end, done)

        if service.is_busy:
            self._end(Outcome(False, f"{self._who}: still busy with {service.name}"), done)
        elif not service.is_there:
            self._end(Outcome(False, f"{self._who} is not running (no service {service.full_name})"), done)
        else:
            service.call(request, time.monotonic(), answered)

    def _end(self, end: Outcome, done: Done) -> None:
        if end.sentence:
            self._say(end.sentence)
        done(end)


class Switch:
    """A service that switches something on or off, with nothing lost where a person is faster than it.

    What is asked for during a call is sent once that has ended; of several requests only the newest.

    Args:
        node: The node whose executor delivers the answers.
        name: Name of the SetBool service, relative to the node's namespace.
        who: The other node in words, such as "simulator".
        say: Called with a sentence for the person.
    """

    def __init__(self, node: Node, name: str, who: str, say: Callable[[str], None]) -> None:
        self._request, self._who = Request(node, SetBool, name, who, say), who
        self._asked: bool | None = None
        self._next: tuple[bool, Done, Callable[[], str]] | None = None

    @property
    def is_there(self) -> bool:
        """A server has been found."""
        return self._request.is_there

    @property
    def is_busy(self) -> bool:
        """A call is under way."""
        return self._request.is_busy

    def expire(self, now: float) -> None:
        """Give up a call that has waited too long; `now` is a steady clock in [s]."""
        self._request.expire(now)

    def opposite(self, present: bool) -> bool:
        """What a press asks for: the opposite of what is asked for and not answered yet, or of `present`."""
        return not (present if self._asked is None else self._asked)

    def set(self, on: bool, done: Done, on_success: Callable[[], str]) -> None:
        """Switch it on or off; see `Request.ask` for the other arguments."""
        self._asked = on
        if self._request.is_busy:
            overtaken, self._next = self._next, (on, done, on_success)
            if overtaken is not None:
                overtaken[1](Outcome(False, f"{self._who}: a newer request came before the answer"))
            return

        def ended(end: Outcome) -> None:
            following, self._next = self._next, None
            if following is None:
                self._asked = None
            done(end)
            if following is not None:
                self.set(*following)

        self._request.ask(SetBool.Request(data=on), ended, on_success)
