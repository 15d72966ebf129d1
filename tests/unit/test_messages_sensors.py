"""What sensors tell as messages, beside what the simulation says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from softsim_core import Simulation, load_scene
from softsim_core.base import Array
from softsim_core.control.inverse import tilts_of
from softsim_core.physics.mechanics import rotation_log, rotation_of
from softsim_core.physics.sensing import (
    ImuDescription,
    Output,
    Quantity,
    SensorReading,
    SimulatedSensorDescription,
)

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


@dataclass(frozen=True, slots=True, kw_only=True)
class OwnDescription(SimulatedSensorDescription):
    """A sensor of one's own whose noise is unknown."""

    kind: ClassVar[str] = "own"
    quantity: Quantity

    @property
    def outputs(self) -> tuple[Output, ...]:
        return (Output(self.quantity),)


@pytest.mark.parametrize(
    ("quantity", "value"),
    [
        (Quantity.WRENCH, np.arange(6.0)),
        (Quantity.PRESSURES, np.ones((2, 3))),
        (Quantity.INERTIAL, np.arange(6.0)),
        (Quantity.INERTIAL, np.arange(10.0)),
        (Quantity.POINTS, np.ones((4, 3))),
        (Quantity.NUMBER, np.array(3.0)),
        (Quantity.JOINT, np.array([1.0, 2.0])),
        (Quantity.PRESSURE, np.array(5.0)),
        (Quantity.NUMBERS, np.ones((2, 2))),
    ],
)
def test_a_quantity_of_unknown_noise_has_a_message(quantity: Quantity, value: Array) -> None:
    described = OwnDescription(name="own", quantity=quantity)
    ((below, kind, write),) = messages_of(described, 100.0)
    message = write(Header(), SensorReading(described, value, 0.5, 7))
    assert (below, type(message)) == ("", kind)
    if quantity is Quantity.INERTIAL:
        assert message.orientation_covariance[0] == (-1.0 if len(value) == 6 else 0.0)
        assert (message.linear_acceleration_covariance == 0.0).all()
    if quantity is Quantity.PRESSURE:
        assert (message.fluid_pressure, message.variance) == (105.0, 0.0)


def test_every_quantity_is_tried() -> None:
    (mark,) = test_a_quantity_of_unknown_noise_has_a_message.pytestmark
    assert {quantity for quantity, _ in mark.args[1]} == set(Quantity)
