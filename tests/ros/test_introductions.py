"""Whom a test has met: also where two nodes have one name, as while the end of the first is not known yet."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.importorskip("rclpy")

from introductions import Introductions
from node_processes import Client, spin_until
from rclpy.context import Context
from rclpy.node import Node
from std_srvs.srv import Trigger

from softsim_ros import SpinThread

pytestmark = pytest.mark.ros


@pytest.fixture
def namesakes(ros_domain: int) -> Iterator[list[Node]]:
    """Four nodes of one name, each of a participant of its own, served by a thread."""
    contexts = [Context() for _ in range(4)]
    for context in contexts:
        context.init(domain_id=ros_domain)
    nodes = [Node("simulator", context=context, namespace="/tripod") for context in contexts]
    spinners = [SpinThread([node], context) for node, context in zip(nodes, contexts, strict=True)]
    for spinner in spinners:
        spinner.__enter__()
    yield nodes
    for spinner in spinners:
        spinner.__exit__(None, None, None)
    for node, context in zip(nodes, contexts, strict=True):
        node.destroy_node()
        context.try_shutdown()


@pytest.mark.slow
@pytest.mark.parametrize("index", range(4))
def test_the_one_of_several_namesakes_that_offers_a_service_is_met(
    ros_domain: int, namesakes: list[Node], index: int
) -> None:
    client = Client(ros_domain, "/tripod")
    try:
        namesakes[index].create_service(Trigger, "~/step", lambda _, answer: answer)
        met = Introductions(client.node, str)
        met.wait("/tripod/simulator/step")
        step = ("/tripod/simulator/step", ["std_srvs/srv/Trigger"])
        assert spin_until(lambda: step in client.offered("simulator", "/tripod", services=True).items())
        assert spin_until(lambda: "/parameter_events" in client.offered("simulator", "/tripod"))
        assert client.offered("simulator", "/finger") == {}
    finally:
        client.close()
