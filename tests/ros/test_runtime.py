"""Start, spin, shutdown and parameters that all nodes share."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

from node_processes import hung_in_middleware  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.node import Node  # noqa: E402
from waiting import DEADLINE_S  # noqa: E402

from softsim_core.base import SceneError  # noqa: E402
from softsim_node import GuardedNode, Program, run_node  # noqa: E402
from softsim_ros import (  # noqa: E402
    SpinThread,
)


@pytest.fixture
def context(ros_domain: int) -> Iterator[Context]:
    own = Context()
    own.init(args=[], domain_id=ros_domain)
    yield own
    own.try_shutdown()


@pytest.fixture
def node(context: Context) -> Iterator[Node]:
    own = Node("spun", context=context)
    yield own
    own.destroy_node()


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


class Failing(GuardedNode):
    def __init__(self) -> None:
        raise SceneError("scene x: no such thing; known: y")


class Stopping(GuardedNode):
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


HANGING = """
import ctypes
import sys

from softsim_node import process
from softsim_node import GuardedNode, Program

process.END_LIMIT_S = 1.0


class Hanging(GuardedNode):
    def __init__(self):
        super().__init__("hanging")
        self.create_timer(0.01, self.context.try_shutdown)

    def destroy_node(self):
        ctypes.PyDLL(None).pause()  # holds Python's lock, as rclpy does while Fast DDS is taken down


sys.exit(process.run_node(Program(name="trial", about="Tries."), lambda _: Hanging(), []))
"""


@pytest.mark.slow
def test_a_node_that_hangs_at_its_end_is_ended_and_shows_where(ros_domain: int) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", HANGING], capture_output=True, text=True, check=False, timeout=DEADLINE_S
    )
    assert ended.returncode == 1
    with pytest.warns(UserWarning, match=r"Fast DDS hung(?s:.*)in destroy_node"):
        assert hung_in_middleware(ended.stderr)
