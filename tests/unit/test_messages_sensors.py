"""What sensors tell as messages, beside what the simulation says."""

from __future__ import annotations

import numpy as np
import pytest

from softsim_core import Simulation, load_scene
from softsim_core.control.inverse import tilts_of
from softsim_core.physics.mechanics import rotation_log, rotation_of
from softsim_core.physics.sensing import ImuDescription

pytest.importorskip("rclpy")
from std_msgs.msg import Header

from softsim_ros import topic_words
from softsim_ros.messages import messages_of
from softsim_ros.nodes.inverse import imu_tilts


@pytest.mark.slow
def test_the_orientation_of_an_imu_is_what_the_closed_loop_takes() -> None:
    noise = 0.01
    units = (
        ImuDescription(name="exact", on="centre", orientation_noise=0.0),
        ImuDescription(name="noisy", on="centre", orientation_noise=noise),
    )
    simulation = Simulation(load_scene("tripod").with_scene(sensors=units), backend="scipy")
    simulation.command([-0.3, 0.2, 0.1])
    turns = []
    for _ in range(60):
        simulation.step()
        wanted = rotation_of(simulation.effector_pose.quaternion_xyzw)  # type: ignore[union-attr]
        told = rotation_of(simulation.sensors["noisy"].value[6:])
        turns.append(rotation_log(wanted.T @ told))
    assert np.std(turns) == pytest.approx(noise, rel=0.2)
    ((_, _, write),) = messages_of(units[0], 0.0)
    message = write(Header(), simulation.sensors["exact"])
    assert (message.orientation_covariance == 0.0).all()
    np.testing.assert_allclose(imu_tilts(message), tilts_of(wanted)[:2], atol=1e-9)
    ((_, _, write),) = messages_of(units[1], 0.0)
    assert write(Header(), simulation.sensors["noisy"]).orientation_covariance[8] == noise**2


def test_every_sensor_has_a_word_of_its_own_in_topics() -> None:
    assert topic_words(["a b", "a_b", "9", "", "a" * 99], "sensor") == [
        "a_b",
        "a_b_",
        "sensor_9",
        "sensor_",
        "a" * 60,
    ]
