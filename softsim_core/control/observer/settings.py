"""Settings of an observer: uncertainty of the model, contact detection; and the estimate it returns."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Literal, TypeAlias

from softsim_core.base import Array, FieldError, FormerAttribute
from softsim_core.physics.mechanics import Pose

Verdict: TypeAlias = Literal["alone", "learning", "good", "wrong"]


@dataclass(frozen=True, slots=True, eq=False)
class Touch:
    """Estimated contact, expressed as a load on the effector.

    Attributes:
        force, moment: In [N] and [N m], world axes, shapes (3,).
        deviation: Their standard deviations, shape (6,).
    """

    force: Array
    moment: Array
    deviation: Array


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Result of one step.

    Attributes:
        effector: Pose of the effector; None: the robot has none.
        effector_covariance: Covariance of its position in [m] and rotation about world axes in [rad], (6, 6).
        touch: The contact; None: none was detected.
        verdict: "alone": nothing is measured; "learning"; "good"; "wrong": the model or the stated noise of
            the sensors is wrong.
        message: Message that says why it is wrong; else empty.
        consistency: Mean squared innovation of the window in units of its expected value: 1 if the model is
            consistent.
        used: Number of coordinates used in this step.
        left_out: Sensors whose measurement was an outlier in this step.
    """

    effector: Pose | None
    effector_covariance: Array
    touch: Touch | None
    verdict: Verdict
    message: str
    sentence = FormerAttribute("message")
    consistency: float
    used: int
    left_out: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class ObserverSettings:
    """Standard deviations of the model's unknowns, and thresholds.

    The unknowns change with time (per square root of a second) and with travel (per square root of a radian
    of joint travel, or of a slide's metre, cable's centimetre...: see Limits.scale). The error of a wrong
    model differs from pose to pose, and does not change while nothing moves.

    Attributes:
        joint_offset: Zero of each joint in [rad]; of other joints times Limits.scale.
        load_share: Weight (or softness: twice as soft is twice as heavy) as a share of the model's.
        push, push_moment: A steady force in [N] on the effector and moment in [N m]: a tool, a hose.
        sensor_offset, sensor_turn: Misplacement of each sensor in [m] and [rad], per coordinate; also local
            errors of the model's shape.
        sensor_offset_per_travel, sensor_turn_per_travel: Their change with travel.
        offset_per_travel, share_per_travel, push_per_travel, moment_per_travel: Their change with travel.
        drift: Their change with time, as a part of them per square root of a second.
        touch, touch_moment: Contact: force in [N] and moment in [N m] on the effector at its onset.
        touch_rate: Its change per square root of a second, as a part of them.
        joint_noise: Noise of the joints' read-back in [rad]; of other joints times Limits.scale.
        latency: Timing error of the sensors in [s]: moving coordinates are measured less accurately.
        false_contacts: Expected false contacts per hour, if the noise is as stated.
        release: Time in [s] without evidence after which a contact ends.
        outlier: Squared distance of a measurement from its expected value, in squared standard deviations per
            coordinate, beyond which it is not used.
        patience: Number of consecutive outliers of a sensor after which they are used.
        window: Duration in [s] of the innovations in the consistency test.
        learning: Initial time in [s] without consistency test and contact detection.
        silence: Time in [s] without measurement after which the verdict is "alone".

    Raises:
        FieldError: a value is negative or not finite.
    """

    joint_offset: float = 0.05
    load_share: float = 0.5
    push: float = 0.2
    push_moment: float = 2e-3
    sensor_offset: float = 1e-4
    sensor_turn: float = 5e-3
    sensor_offset_per_travel: float = 1e-4
    sensor_turn_per_travel: float = 2e-3
    offset_per_travel: float = 5e-3
    share_per_travel: float = 0.02
    push_per_travel: float = 0.02
    moment_per_travel: float = 2e-4
    drift: float = 2e-3
    touch: float = 0.3
    touch_moment: float = 3e-3
    touch_rate: float = 0.3
    joint_noise: float = 0.0
    latency: float = 2e-3
    false_contacts: float = 1e-2
    release: float = 0.3
    outlier: float = 25.0
    patience: int = 3
    window: float = 1.0
    learning: float = 1.0
    silence: float = 0.5

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not 0.0 <= value < math.inf:
                raise FieldError("observer", field.name, value, "a finite number >= 0")
        for name in ("touch", "touch_moment", "false_contacts", "window"):
            if getattr(self, name) == 0.0:
                raise FieldError("observer", name, 0.0, "> 0")
