"""Life of the simulator's process: signals, wrong starts, namespaces, kill -9."""

from __future__ import annotations

import signal
from typing import Any

import pytest
from node_processes import NodeProcess
from waiting import BUILD_S, DEADLINE_S

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.slow]

from sensor_msgs.msg import JointState  # noqa: E402

from softsim_ros.nodes.simulator import main  # noqa: E402

SIMULATOR = "softsim_ros.nodes.simulator.simulator_node"


def ends_cleanly(process: NodeProcess, number: signal.Signals) -> None:
    assert process.end(number) == 0, process.output
    assert "Traceback" not in process.output
    assert "rror" not in process.output


def test_a_signal_while_it_builds_ends_it_cleanly(start_process: Any) -> None:
    process = start_process(SIMULATOR)
    assert process.says("building", BUILD_S), process.output
    ends_cleanly(process, signal.SIGINT)


def test_the_namespace_is_the_robots_name_unless_given_and_a_signal_ends_it_cleanly(
    start_process: Any, client: Any, spin_until: Any
) -> None:
    process = start_process(SIMULATOR, "--ros-args", "-r", "__ns:=/left", "-p", "robot:=parts/servo")
    assert process.says("simulating servo", BUILD_S), process.output
    assert spin_until(lambda: ("simulator", "/left") in client.node.get_node_names_and_namespaces())
    ends_cleanly(process, signal.SIGTERM)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("-p", "robot:=nosuchrobot"), "nosuchrobot"),
        (
            ("-p", "backend:=cuda"),
            "parameter backend = 'cuda' is refused; allowed is one of: auto, numba, scipy",
        ),
        (("-p", "nonsense"), "nonsense"),
    ],
)
def test_a_wrong_start_is_one_sentence(
    ros_domain: int, capfd: pytest.CaptureFixture[str], arguments: tuple[str, ...], sentence: str
) -> None:
    assert main(["--ros-args", *arguments]) == 1
    written = "".join(capfd.readouterr())
    lines = [line for line in written.splitlines() if "[INFO]" not in line and "[rcl]" not in line]
    assert len(lines) == 1, written
    assert sentence in lines[0]


def test_after_kill_nine_it_starts_again(start_robot: Any, spin_until: Any) -> None:
    first = start_robot()
    first.process.process.kill()
    assert first.process.process.wait(DEADLINE_S) == -signal.SIGKILL
    second = start_robot()
    states = second.client.collect(JointState, "joint_states")

    def moved() -> bool:
        second.command([-0.3] * 3)  # again and again: the dead one still counts as a listener for a while
        return bool(states) and abs(states[-1].position[0] + 0.3) < 1e-9

    assert spin_until(moved)
    assert second.process.end() == 0
