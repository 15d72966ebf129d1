"""Settings of an observer: how far the model may be off, what counts as contact; and its estimate."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Literal, TypeAlias

from softsim_core.base import Array, FieldError
from softsim_core.physics.mechanics import Pose

Verdict: TypeAlias = Literal["alone", "learning", "good", "wrong"]


@dataclass(frozen=True, slots=True, eq=False)
class Touch:
    """What touches the robot, as if it did so at the effector.

    Attributes:
        force, moment: In [N] and [N m], world axes, shapes (3,).
        deviation: Their standard deviations, shape (6,).
    """

    force: Array
    moment: Array
    deviation: Array


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """What one step found.

    Attributes:
        effector: Pose of the effector; None: the robot has none.
        effector_covariance: Of its position in [m] and rotation about world axes in [rad], shape (6, 6).
        touch: What touches; None: nothing that was found.
        verdict: "alone": nothing is measured; "learning"; "good"; "wrong": the model, or what is said of the
            sensors' noise.
        sentence: Why it is wrong; else empty.
        consistency: Mean squared innovation of the window in units of what is expected: 1 where all is
            as believed.
        used: Coordinates that were used in this step.
        left_out: Sensors of which this step's measurement was an outlier.
    """

    effector: Pose | None
    effector_covariance: Array
    touch: Touch | None
    verdict: Verdict
    sentence: str
    consistency: float
    used: int
    left_out: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class ObserverSettings:
    """Standard deviations of what the model does not know, and thresholds.

    What is unknown changes with time (per root of a second) and with travel (per root of a radian that a
    joint goes, or of a slide's metre, cable's centimetre...: see Limits.scale): a model that is wrong is so
    differently in another pose, and stays as wrong as it is while nothing moves.

    Attributes:
        joint_offset: Zero of each joint in [rad]; of other joints times Limits.scale.
        load_share: Weight (or softness: twice as soft is twice as heavy) as a share of the model's.
        push, push_moment: A steady force in [N] on the effector and moment in [N m]: a tool, a hose.
        sensor_offset, sensor_turn: Each sensor is not where it is said to be, by this in [m] and [rad], in
            each of its coordinates; or what the model's shape misses there in its own way.
        sensor_offset_per_travel, sensor_turn_per_travel: Their change with travel.
        offset_per_travel, share_per_travel, push_per_travel, moment_per_travel: Their change with travel.
        drift: Their change with time, as a part of them per root of a second.
        touch, touch_moment: Contact: force in [N] and moment in [N m] on the effector, as it comes.
        touch_rate: Its change per root of a second, as a part of them.
        joint_noise: Noise of the joints' read-back in [rad]; of other joints times Limits.scale.
        latency: Sensors are late or early by this in [s]: what moves is measured less well.
        false_contacts: Expected false contacts per hour, where noise is as it is said to be.
        release: A contact ends when for so long, in [s], nothing speaks for it.
        outlier: A sensor's squared distance from the expected, in standard deviations squared per
            coordinate, beyond which one is left out.
        patience: So many outliers of a sensor in a row are no outliers.
        window: The model is judged by the innovations of the last so many [s].
        learning: It is not judged, and contacts are not looked for, during the first so many [s].
        silence: Nothing measured for so long, in [s], and the model is alone.

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
