"""Services of a simulator in another process: pause, step, reset, save, load, start."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.shared_robot("tripod")]

from geometry_msgs.msg import PoseStamped  # noqa: E402
from sensor_msgs.msg import JointState, PointCloud2  # noqa: E402


class View:
    """Everything a client sees of the state, as bytes that two equal states share."""

    def __init__(self, robot: Any, spin_until: Any) -> None:
        self._wait = spin_until
        self._topics = [
            robot.client.collect(JointState, "joint_states"),
            robot.client.collect(PoseStamped, "effector_pose"),
            robot.client.collect(PointCloud2, "mesh/points"),
        ]

    def state(self) -> tuple[bytes, str, bytes]:
        """What comes from now on, of a paused simulator."""
        for topic in self._topics:
            topic.clear()
        assert self._wait(lambda: all(len(topic) > 1 for topic in self._topics))  # the first may be older
        joints, pose, points = (topic[-1] for topic in self._topics)
        numbers = b"".join(values.tobytes() for values in (joints.position, joints.velocity, joints.effort))
        return numbers, repr(pose.pose), bytes(points.data)


@pytest.fixture
def paused(tripod: Any) -> Any:
    """The Tripod at its start, paused there."""
    assert tripod.pause(True) == (True, "paused")
    assert tripod.trigger("reset") == (True, "back at the start of the scene; still paused")
    return tripod


def steps(robot: Any, count: int) -> None:
    for _ in range(count):
        assert robot.trigger("step")[0]


def test_a_paused_simulation_steps_one_at_a_time(paused: Any, spin_until: Any) -> None:
    states = paused.client.collect(JointState, "joint_states")

    def position() -> float:
        states.clear()
        assert spin_until(lambda: len(states) > 1)  # the first may be older
        return float(states[-1].position[0])

    assert paused.trigger("step") == (True, "step 1 done")
    assert paused.trigger("step") == (True, "step 2 done")
    paused.command([-1.0] * 3)  # may arrive after the next request
    assert spin_until(lambda: paused.trigger("step")[0] and states and states[-1].position[0] < 0.0)
    begin = position()
    steps(paused, 3)
    assert position() - begin == pytest.approx(-3 * 0.01 * 3.5)  # three steps at 3.5 rad/s


def test_a_running_simulation_refuses_to_step(tripod: Any) -> None:
    success, sentence = tripod.trigger("step")
    assert not success
    assert sentence == "step refused: the simulation is running; pause it first"


def test_reset_gives_the_same_bytes_back(paused: Any, spin_until: Any) -> None:
    view = View(paused, spin_until)
    begin = view.state()
    steps(paused, 5)
    assert view.state() != begin
    assert paused.trigger("reset")[0]
    assert view.state() == begin


def test_the_same_steps_give_the_same_bytes(paused: Any, spin_until: Any) -> None:
    view = View(paused, spin_until)
    seen = []
    for _ in range(2):
        assert paused.trigger("reset")[0]
        assert paused.trigger("start")[0]
        steps(paused, 12)
        seen.append(view.state())
    assert seen[0] == seen[1]


def test_a_saved_state_comes_back_and_goes_on_the_same_way(paused: Any, spin_until: Any) -> None:
    view = View(paused, spin_until)
    assert paused.trigger("start")[0]
    steps(paused, 8)
    success, sentence = paused.trigger("save")
    assert success
    assert sentence.endswith("softsim/tripod.snapshot")
    saved = view.state()
    steps(paused, 6)
    later = view.state()
    assert paused.trigger("reset")[0]
    assert paused.trigger("load")[0]
    assert view.state() == saved
    steps(paused, 6)
    assert view.state() == later


def test_a_loaded_state_brings_its_material_along(paused: Any) -> None:
    assert paused.set_parameters(young_modulus=100.0e3)[0]
    assert paused.trigger("save")[0]
    assert paused.set_parameters(young_modulus=300.0e3)[0]
    assert paused.trigger("load")[0]
    assert paused.get_parameter("young_modulus") == 100.0e3


def test_what_is_no_snapshot_is_refused(paused: Any) -> None:
    folder = Path(paused.get_parameter("snapshot_folder"))
    assert paused.set_parameters(snapshot="none")[0]
    assert paused.trigger("load") == (
        False,
        f"snapshot {folder / 'none.snapshot'} does not exist; save one first",
    )
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "other.snapshot").write_bytes(b"not a snapshot")
    assert paused.set_parameters(snapshot="other")[0]
    success, sentence = paused.trigger("load")
    assert not success
    assert "snapshot" in sentence
    assert paused.set_parameters(snapshot="tripod")[0]


def test_start_plays_the_start_animation(tripod: Any, spin_until: Any) -> None:
    states = tripod.client.collect(JointState, "joint_states")
    assert tripod.trigger("start") == (True, "start animation begun")
    assert spin_until(lambda: states and math.isclose(states[-1].position[1], -1.4965, abs_tol=1e-12))
