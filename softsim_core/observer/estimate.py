"""What an observer tells after each step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from softsim_core.arrays import Array
from softsim_core.mechanics.pose import Pose

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
