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
        ends = self._ends if services else graph.get_publishers_info_by_topic
        return {
            name: types
            for name, types in names
            if any((end.node_name, end.node_namespace) == wanted for end in ends(name))
        }

    def wait(self, service: str) -> None:
        """Wait until every process that offers a service (its full name) has found this one."""
        assert spin_until(lambda: self._all_met(service)), (
            f"nobody is known to offer {service}, or whoever does has no parameters to ask for;"
            f" known are {self._node.get_service_names_and_types()}{self._written()}"
        )

    def _all_met(self, service: str) -> bool:
        """Whether all who offer a service now are met; strangers among them are asked first."""
        offering = self._answering(service)
        for stranger in offering - self._met:
            question = self._question(stranger)
            if question is None:
                return False
            self._ask(question, stranger)
        return bool(offering)

    def _ends(self, service: str) -> Any:
        """Endpoints that answer questions to a service."""
        return self._node.get_publishers_info_by_topic(f"rr{service}Reply", no_mangle=True)

    def _answering(self, service: str) -> set[bytes]:
        """Participants that offer a service."""
        return {participant(end) for end in self._ends(service)}

    def _question(self, stranger: bytes) -> str | None:
        """A service of a participant that changes nothing, where one is known.

        It is found by its endpoint: the names of a participant's nodes come in a message of their own, which
        may be lost.
        """
        for name, types in self._node.get_service_names_and_types():
            if "rcl_interfaces/srv/GetParameters" in types and stranger in self._answering(name):
                return str(name)
        return None

    def _ask(self, question: str, stranger: bytes) -> None:
        """Ask until an answer comes, or until the end of a killed process, known for seconds, is noticed."""
        from rcl_interfaces.srv import GetParameters

        client = self._node.create_client(GetParameters, question)
        answered = threading.Event()
        end = time.monotonic() + DEADLINE_S
        while not answered.is_set() and stranger in self._answering(question):
            assert time.monotonic() < end, f"no answer from {question}{self._written()}"
            client.call_async(GetParameters.Request()).add_done_callback(lambda _: answered.set())
            answered.wait(REPEATED_AFTER_S)
        self._node.destroy_client(client)
        if answered.is_set():
            self._met.add(stranger)


def participant(end: Any) -> bytes:
    """Identifier of the participant that an endpoint belongs to."""
    return bytes(end.endpoint_gid[:GID_PREFIX])
