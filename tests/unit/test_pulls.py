"""What a pull by hand takes from a wrench."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy")

from geometry_msgs.msg import Vector3, Wrench

from softsim_ros.nodes.simulator import is_turned


def wrench(force: float, torque: float) -> Wrench:
    return Wrench(force=Vector3(x=force), torque=Vector3(z=torque))


@pytest.mark.parametrize(("force", "torque"), [(1.0, 0.0), (0.0, 0.0), (1.0, 1e-17), (10.0, -3e-16)])
def test_the_round_off_of_a_torque_is_none(force: float, torque: float) -> None:
    assert not is_turned(wrench(force, torque))


@pytest.mark.parametrize(("force", "torque"), [(1.0, 1e-3), (0.0, 1e-17), (1.0, float("nan"))])
def test_a_torque_is_seen(force: float, torque: float) -> None:
    assert is_turned(wrench(force, torque))
