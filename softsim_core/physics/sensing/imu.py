r"""An inertial measurement unit: specific force and angular rate of a frame.

Over a step from :math:`k-1` to :math:`k` of length h, with the velocity v of its origin,

.. math:: f = R^T \Bigl(\frac{v_k - v_{k-1}}{h} - g\Bigr)

where R is its rotation in the middle of the step, found by turning back half a step's spin. This is the mean
over the step, of second order in h for even rotation. The angular rate is the frame's spin in its own axes.

Source: Titterton, Weston 2004, Strapdown inertial navigation technology.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from softsim_core.base import LOCAL, Array, Placement, Vector
from softsim_core.physics.mechanics import quaternion_of, rotation_exp, rotation_of
from softsim_core.physics.sensing.description import (
    PLACE,
    Mount,
    Output,
    Quantity,
    Scenery,
    SensorKind,
    SimulatedSensorDescription,
    both,
)
from softsim_core.physics.sensing.sensor import Sensor, StepObservation


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuDescription(SimulatedSensorDescription):
    """Accelerometer and gyroscope on a rigid frame: specific force in [m/s^2] and angular rate in [rad/s].

    The specific force is the acceleration minus gravity: at rest it points up. It is the mean over the last
    step, in the unit's own axes. A unit that also estimates its orientation appends it as a quaternion
    (x, y, z, w).

    Attributes:
        on: Frame that carries it: an attachment (a free frame, or the frame its region is attached to), a
            joint with a frame (the frame that it moves), a rigid body (with mass: its centre of mass),
            "world".
        pose: Its placement in that frame (the scale is not used).
        accelerometer_noise: Standard deviation of a specific force sample in [m/s^2].
        gyroscope_noise: Standard deviation of an angular rate sample in [rad/s].
        accelerometer_bias: Bias of the specific force in [m/s^2].
        gyroscope_bias: Bias of the angular rate in [rad/s].
        orientation_noise: Standard deviation in [rad], about each axis, of the measured orientation in the
            world; None: it measures none.
    """

    kind: ClassVar[str] = "imu"
    named_parts: ClassVar[Mapping[str, str]] = {"on": PLACE}
    on: str
    pose: Placement = field(default=Placement(), metadata=LOCAL)
    accelerometer_noise: float = 0.0
    gyroscope_noise: float = 0.0
    accelerometer_bias: Vector = (0.0, 0.0, 0.0)
    gyroscope_bias: Vector = (0.0, 0.0, 0.0)
    orientation_noise: float | None = None

    @property
    def outputs(self) -> tuple[Output, ...]:
        """Specific force, angular rate and, if it is measured, orientation."""
        deviations = self.accelerometer_noise, self.gyroscope_noise, self.orientation_noise
        return (Output(Quantity.INERTIAL, deviations=tuple(each for each in deviations if each is not None)),)

    @property
    def mount(self) -> Mount:
        """Its own frame."""
        return Mount(self.on, self.pose)


def inertial(
    before: Array, velocity: Array, spin: Array, rotation: Array, gravity: Array, dt: float
) -> tuple[Array, Array]:
    """Return the perfect measurement of a unit in each of k frames over a step; see the module.

    Args:
        before: Velocity of the origin in [m/s] before the step, shape (k, 3).
        velocity: Velocity of the origin in [m/s] after the step, shape (k, 3).
        spin: Angular velocity after the step in [rad/s], world axes, shape (k, 3).
        rotation: Rotations after the step, shape (k, 3, 3).
        gravity: Gravity in [m/s^2], shape (3,) or (k, 3).
        dt: Length of the step in [s].

    Returns:
        Specific force in [m/s^2] and angular rate in [rad/s], in the axes of the frames, shape (k, 3) each.
    """
    middle = np.array([rotation_exp(-0.5 * dt * each) for each in spin]) @ rotation
    force = (velocity - before) / dt - gravity
    return np.einsum("kj,kji->ki", force, middle), np.einsum("kj,kji->ki", spin, rotation)


class Imu(Sensor):
    """Sensor of specific force, angular rate and, optionally, orientation of a frame."""

    def __init__(self, described: ImuDescription, scenery: Scenery) -> None:
        super().__init__(
            both(described.accelerometer_noise, described.gyroscope_noise),
            both(described.accelerometer_bias, described.gyroscope_bias),
        )
        self._place = scenery.places[described.on].within(described.pose)
        self._turning = described.orientation_noise

    @property
    def random(self) -> bool:
        """Whether a sample has random noise, including that of the orientation."""
        return bool(self.noise.any() or self._turning)

    def measure(self, observation: StepObservation) -> Array:
        """Return specific force, angular rate and, if measured, orientation, shape (6,) or (10,)."""
        model, place = observation.model, self._place
        (velocity, spin), (earlier, _) = (
            place.twist(model, each) for each in (observation.state, observation.before)
        )
        now = place.pose(model, observation.state)[1]
        force, rate = inertial(earlier[None], velocity[None], spin[None], now[None], model.gravity, model.dt)
        motion = (force[0], rate[0])
        return np.concatenate(motion if self._turning is None else (*motion, quaternion_of(now)))

    def add_noise(self, value: Array, generator: np.random.Generator | None) -> Array:
        """Return the sample with bias and noise; the orientation turns by a small angle about its axes."""
        sample = super().add_noise(value[:6], generator)
        if self._turning is None or generator is None:
            return np.concatenate([sample, value[6:]])
        turn = rotation_exp(self._turning * generator.standard_normal(3))
        return np.concatenate([sample, quaternion_of(rotation_of(value[6:]) @ turn)])


IMU = SensorKind(ImuDescription, Imu)
