"""Servers that have found this process whole: only then does no answer of theirs get lost.

A server that has found the requests of another process, but not yet where its answers go, drops the answer
after a tenth of a second. This happens while two processes find each other, and no longer once one answer has
come. So a question that changes nothing is asked until it is answered, and whatever counts is asked once.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from waiting import DEADLINE_S, spin_until

REPEATED_AFTER_S = 1.0
GID_PREFIX = 12
"""Bytes of an endpoint's identifier that name its participant."""


class NewsLostError(AssertionError):
    """A process offers a service, and this one never got to hear by which node."""


class Introductions:
    """Whom a node of the test has met, by participant: a process that starts again is met again.

    Args:
        node: The node; a thread serves its callbacks.
        written: What the processes of the test have written, for a failure to show.
    """

    def __init__(self, node: Any, written: Callable[[], str]) -> None:
        self._node, self._written = node, written
        self._met: set[bytes] = set()

    def offered(self, node: str, namespace: str, *, services: bool = False) -> dict[str, list[str]]:
        """Types of what a node publishes (or of its services) by name, as far as the graph knows.

        By who owns each endpoint. What the graph tells of a node by name is what it knows of the first of
        that name; and one that ended while its last list of endpoints was read stays known, with none.
        """
        graph, wanted = self._node, (node, namespace)
        names = graph.get_service_names_and_types() if services else graph.get_topic_names_and_types()
        ends = self._answering if services else graph.get_publishers_info_by_topic
        return {
            name: types
            for name, types in names
            if any((end.node_name, end.node_namespace) == wanted for end in ends(name))
        }

    def wait(self, service: str) -> None:
        """Wait until the process that offers a service (its full name) has found this one.

        Raises:
            NewsLostError: no node is known to offer it, or none that does can be asked.
        """
        if not spin_until(lambda: self._all_met(service)):
            nodes = sorted(self._node.get_node_names_and_namespaces())
            raise NewsLostError(
                f"no node is known to offer {service}, or none that does can be asked; known are {nodes},"
                f" by process {self._participants()}{self._written()}"
            )

    def _all_met(self, service: str) -> bool:
        """Whether all who offer a service now are met; strangers among them are asked first.

        Who offers it may change in between: a process that was killed is known for seconds after its end.
        """
        offering = self._offered_by(service)
        strangers = offering - self._met
        if questions := self._questions(strangers):
            self._ask(questions[0])
            self._met |= strangers
        return bool(offering) and offering <= self._met

    def _answering(self, service: str) -> Any:
        """Endpoints that answer questions to a service."""
        return self._node.get_publishers_info_by_topic(f"rr{service}Reply", no_mangle=True)

    def _offered_by(self, service: str) -> set[bytes]:
        """Participants that offer a service, as far as all that is needed to meet them is known."""
        offering = {participant(end) for end in self._answering(service)}
        known = set().union(*self._participants().values())
        return offering if offering <= known else set()

    def _questions(self, strangers: set[bytes]) -> list[str]:
        """Services that change nothing, of any node of these participants."""
        nodes = [node for node, found in self._participants().items() if found & strangers]
        questions = [f"{space.rstrip('/')}/{name}/get_parameters" for name, space in nodes]
        return [each for each in questions if self._answering(each)]

    def _participants(self) -> dict[tuple[str, str], set[bytes]]:
        """Identifiers of the participants that run a node, by its name and namespace."""
        found: dict[tuple[str, str], set[bytes]] = {}
        for end in self._node.get_publishers_info_by_topic("/parameter_events"):  # every node has this one
            node = (end.node_name, end.node_namespace)
            found.setdefault(node, set()).add(participant(end))
        return found

    def _ask(self, question: str) -> None:
        from rcl_interfaces.srv import GetParameters

        client = self._node.create_client(GetParameters, question)
        answered = threading.Event()
        end = time.monotonic() + DEADLINE_S
        while not answered.is_set():
            assert time.monotonic() < end, f"no answer from {question}{self._written()}"
            client.call_async(GetParameters.Request()).add_done_callback(lambda _: answered.set())
            answered.wait(REPEATED_AFTER_S)
        self._node.destroy_client(client)


def participant(end: Any) -> bytes:
    """Identifier of the participant that an endpoint belongs to."""
    return bytes(end.endpoint_gid[:GID_PREFIX])
