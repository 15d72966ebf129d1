"""Start, spin, shutdown and parameters that all nodes share."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

from rclpy.context import Context  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402

from softsim_core.errors import SceneError  # noqa: E402
from softsim_node.help import Program  # noqa: E402
from softsim_node.parameters import ParameterError  # noqa: E402
from softsim_node.process import run_node  # noqa: E402
from softsim_ros.runtime import (  # noqa: E402
    ClosableNode,
    SpinThread,
    declare_number,
    declare_switch,
    declare_text,
)


@pytest.fixture
def context(ros_domain: int) -> Iterator[Context]:
    own = Context()
    own.init(args=[], domain_id=ros_domain)
    yield own
    own.try_shutdown()


@pytest.fixture
def node(context: Context) -> Iterator[Node]:
    overrides = [
        Parameter("gain", value=2.5),
        Parameter("whole", value=3),
        Parameter("steep", value=99.0),
        Parameter("mode", value="sideways"),
        Parameter("quiet", value="yes"),
    ]
    own = Node("parameters", context=context, parameter_overrides=overrides)
    yield own
    own.destroy_node()


def test_parameters_take_their_start_values(node: Node) -> None:
    assert declare_number(node, "gain", 1.0, "A gain", 0.0, 10.0) == 2.5
    assert declare_number(node, "other", 1.0, "Another", 0.0, 10.0) == 1.0
    assert declare_switch(node, "flag", True, "A switch") is True
    assert declare_text(node, "kind", "a", "A kind", choices=("a", "b")) == "a"
    assert not node.set_parameters([Parameter("gain", value=11.0)])[0].successful
    assert node.set_parameters([Parameter("gain", value=9.0)])[0].successful
    assert not node.set_parameters([Parameter("kind", value="b")])[0].successful  # read-only


def test_wrong_start_values_are_one_sentence_with_what_is_allowed(node: Node) -> None:
    with pytest.raises(
        ParameterError, match="parameter whole has the wrong type; allowed is a number from 0 to 10"
    ):
        declare_number(node, "whole", 1.0, "A number", 0.0, 10.0)
    with pytest.raises(ParameterError, match="parameter steep is refused; allowed is a number from 0 to 10"):
        declare_number(node, "steep", 1.0, "A number", 0.0, 10.0)
    with pytest.raises(ParameterError, match="mode = 'sideways' is refused; allowed is one of: up, down"):
        declare_text(node, "mode", "up", "A mode", choices=("up", "down"))
    with pytest.raises(ParameterError, match="parameter quiet has the wrong type; allowed is true or false"):
        declare_switch(node, "quiet", False, "A switch")


def test_a_spin_thread_serves_callbacks_and_ends(node: Node, context: Context) -> None:
    served = threading.Event()
    node.create_timer(0.01, served.set)
    spinner = SpinThread([node], context)
    with spinner:
        assert served.wait(10.0)
    spinner.close()
    assert "spin" not in [thread.name for thread in threading.enumerate()]


def test_a_spin_thread_outlives_its_context(node: Node, context: Context) -> None:
    with SpinThread([node], context):
        context.try_shutdown()


PROGRAM = Program(name="trial", about="Tries.")


class Failing(ClosableNode):
    def __init__(self) -> None:
        raise SceneError("scene x: no such thing; known: y")


class Stopping(ClosableNode):
    closed: list[str]

    def __init__(self) -> None:
        super().__init__("stopping")
        self.create_timer(0.01, self.context.try_shutdown)

    def close(self) -> None:
        self.closed.append(self.get_name())
        super().close()


def test_run_node_says_errors_of_the_suite_in_a_sentence(ros_domain: int, capfd: Any) -> None:
    assert run_node(PROGRAM, lambda _: Failing(), []) == 1
    assert capfd.readouterr().err == "scene x: no such thing; known: y\n"


def test_run_node_closes_the_node_when_its_context_ends(ros_domain: int, capfd: Any) -> None:
    Stopping.closed = []
    assert run_node(PROGRAM, lambda _: Stopping(), ["--ros-args", "-r", "__node:=renamed"]) == 0
    assert Stopping.closed == ["renamed"]
    assert "nodes on this computer only" in capfd.readouterr().err


def test_run_node_refuses_wrong_ros_arguments(ros_domain: int, capfd: Any) -> None:
    assert run_node(PROGRAM, lambda _: Stopping(), ["--ros-args", "-p", "nonsense"]) == 1
    assert "nonsense" in capfd.readouterr().err.splitlines()[-1]
