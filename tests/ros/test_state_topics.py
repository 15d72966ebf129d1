"""State as data: latched topics that nodes publish at the start and on every change."""

from __future__ import annotations

import signal
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from std_msgs.msg import Bool  # noqa: E402

from softsim_node import (  # noqa: E402
    STATE_TOPICS,
    GuardedNode,
    StateTopics,
)
from softsim_ros import (  # noqa: E402
    SpinThread,
    StateListener,
)

LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def state_topics_of(client: Any, node: str) -> set[str]:
    """Names and types of STATE_TOPICS that a node of the robot publishes, as far as the graph knows them."""
    kinds = {
        f"/tripod/{name}": f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"
        for name, kind in STATE_TOPICS.items()
    }
    offered = client.offered(node, "/tripod").items()
    return {
        name.removeprefix(f"/tripod/{node}/") for name, types in offered if types == [kinds.get(name, "")]
    }


def test_a_fact_is_sent_at_the_start_and_on_every_change(client: Any, spin_until: Any) -> None:
    node = GuardedNode("replay", context=client.context, namespace="tripod")
    paused = False
    topics = StateTopics(node, {"replay/paused": lambda: Bool(data=paused)})
    try:
        heard = client.collect(Bool, "replay/paused", LATCHED)
        assert spin_until(lambda: [each.data for each in heard] == [False])
        paused = True
        topics.refresh()
        topics.refresh()
        assert spin_until(lambda: [each.data for each in heard] == [False, True])
        late = client.collect(Bool, "replay/paused", LATCHED)
        assert spin_until(lambda: late)
        assert [each.data for each in late] == [True]
        assert len(heard) == 2
        paused = False
        with SpinThread([node], client.context):  # the change is not announced
            assert spin_until(lambda: len(heard) == 3)
    finally:
        node.close()


def test_a_fact_that_is_in_no_table_is_refused(client: Any) -> None:
    node = GuardedNode("replay", context=client.context, namespace="tripod")
    with pytest.raises(KeyError, match="replay/speed"):
        StateTopics(node, {"replay/speed": lambda: Bool()})
    node.close()


def test_in_one_process_it_lasts_as_long_as_its_publisher(client: Any, spin_until: Any) -> None:
    """As in `softsim up`, whose terminal hears the nodes beside it: Fast DDS lets their leases run out."""
    node = GuardedNode("recorder", context=client.context, namespace="tripod")
    StateTopics(node, {"recorder/enabled": lambda: Bool(data=True)})
    enabled = StateListener(client.node, "recorder/enabled")
    with SpinThread([node], client.context):
        assert spin_until(lambda: enabled.value is True)
        enabled._on_liveliness(SimpleNamespace(alive_count_change=-1))
        assert enabled.value is True
    node.close()
    assert spin_until(lambda: enabled.value is None)


@pytest.mark.parametrize("start", range(5))
def test_in_one_process_every_end_is_noticed(client: Any, spin_until: Any, start: int) -> None:
    """Fast DDS may tell of a publisher at its end only, and the graph may still list it then."""
    names = [name for name in STATE_TOPICS if name.startswith("servo_bridge/")]
    facts = {name: STATE_TOPICS[name] for name in names}  # a type called without values is a reader
    node = GuardedNode("servo_bridge", context=client.context, namespace="tripod")
    StateTopics(node, facts)
    listener = GuardedNode("listener", context=client.context, namespace="tripod")
    heard = [StateListener(listener, name) for name in names]
    with SpinThread([listener], client.context):
        with SpinThread([node], client.context):
            assert spin_until(lambda: all(each.value is not None for each in heard))
        node.close()
        assert spin_until(lambda: all(each.value is None for each in heard))
    listener.close()


@pytest.mark.slow
def test_a_simulator_tells_its_state_while_it_lives(
    running_tripod: Any, client: Any, spin_until: Any
) -> None:
    assert spin_until(lambda: state_topics_of(client, "simulator") == {"paused", "faulted"})
    node = GuardedNode("listener", context=client.context, namespace="tripod")
    seen: list[Any] = []
    paused = StateListener(node, "simulator/paused", seen.append)
    faulted = StateListener(node, "simulator/faulted")
    assert paused.value is None
    try:
        with SpinThread([node], client.context):
            assert spin_until(lambda: (paused.value, faulted.value) == (False, False))
            assert running_tripod.pause(True) == (True, "paused")
            assert spin_until(lambda: paused.value is True)
            assert running_tripod.pause(False) == (True, "running")
            assert spin_until(lambda: paused.value is False)
            running_tripod.process.process.send_signal(signal.SIGSTOP)
            assert spin_until(lambda: paused.value is None and faulted.value is None)
            running_tripod.process.process.send_signal(signal.SIGCONT)
            assert spin_until(lambda: paused.value is False)
            assert running_tripod.process.end() == 0
            assert spin_until(lambda: paused.value is None)
    finally:
        node.close()
    assert all(sooner != later for sooner, later in pairwise(seen))  # each change is told once
