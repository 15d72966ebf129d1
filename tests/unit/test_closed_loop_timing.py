"""The loop between its messages: waits, holds on a stale measure, and its log replays to the last bit."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip("rclpy")

from geometry_msgs.msg import Quaternion
from sensor_msgs.msg import Imu

from softsim_core.base import CommandError
from softsim_core.control.inverse import TiltController, TiltGains, tilt_rotation
from softsim_core.physics.mechanics import quaternion_of, rotation_exp
from softsim_ros.nodes.inverse import TiltLoop, imu_tilts, pose_tilts


def test_it_waits_for_the_first_measure() -> None:
    loop = TiltLoop(TiltGains(), 0.5)
    loop.begin(100.0)
    assert loop.step(101.0) is None
    loop.store_measurement(np.zeros(2), 101.0)
    step = loop.step(101.02)
    assert step is not None
    assert step.time == pytest.approx(0.02)


def test_a_stale_measure_holds_the_command_and_its_time_does_not_count() -> None:
    loop = TiltLoop(TiltGains(), 0.5)
    loop.begin(0.0)
    loop.reference = np.array([0.1, -0.1])
    loop.store_measurement(np.zeros(2), 0.0)
    before = [loop.step(0.02 * k) for k in range(1, 26)][-1]
    held = [loop.step(0.5 + 0.02 * k) for k in range(1, 100)]
    assert all(step.holds and np.array_equal(step.command, before.command) for step in held)
    loop.store_measurement(np.zeros(2), 2.5)
    again = loop.step(2.5)
    assert not again.holds
    assert again.time == pytest.approx(before.time + 0.02)
    assert np.abs(again.command - before.command).max() < 0.01


def test_its_steps_replay_to_the_last_bit() -> None:
    rng, loop, replay = np.random.default_rng(5), TiltLoop(TiltGains(), 0.5), TiltController()
    now = 12345.678
    loop.begin(now)
    times, commands, inputs = [0.0], [], []
    for _ in range(300):
        now += rng.uniform(0.01, 0.03)
        loop.reference = rng.normal(size=2)
        loop.store_measurement(rng.normal(size=2), now)
        step = loop.step(now)
        times.append(step.time)
        commands.append(step.command)
        inputs.append((step.reference, step.measure))
    again = [replay.update(*pair, elapsed) for pair, elapsed in zip(inputs, np.diff(times), strict=True)]
    assert np.array_equal(again, commands)


def imu(rotation: np.ndarray) -> Imu:
    message = Imu()
    x, y, z, w = quaternion_of(rotation).tolist()
    message.orientation = Quaternion(x=x, y=y, z=z, w=w)
    return message


@pytest.mark.parametrize("heading", [0.0, 1.0, -2.5, math.pi])
def test_an_imu_tells_tilts_whatever_its_heading(heading: float) -> None:
    plate = tilt_rotation(0.3, -0.4)
    turned = rotation_exp(np.array([0.0, 0.0, heading])) @ plate
    assert imu_tilts(imu(turned)) == pytest.approx([0.3, -0.4], abs=1e-12)
    assert pose_tilts(imu(plate).orientation)[:2] == pytest.approx((0.3, -0.4), abs=1e-12)


@pytest.mark.parametrize("wrong", [(0.0, 0.0, 0.0, 0.0), (math.nan, 0.0, 0.0, 1.0), (0.0, 0.0, 2.0, 0.0)])
def test_no_orientation_is_refused(wrong: tuple[float, ...]) -> None:
    message = Imu()
    message.orientation = Quaternion(**dict(zip("xyzw", wrong, strict=True)))
    with pytest.raises(CommandError, match="no unit quaternion"):
        imu_tilts(message)


def test_an_imu_without_orientation_says_so() -> None:
    message = imu(np.eye(3))
    message.orientation_covariance[0] = -1.0
    with pytest.raises(CommandError, match="has no orientation"):
        imu_tilts(message)
