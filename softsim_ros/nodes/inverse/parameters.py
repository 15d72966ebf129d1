"""Parameters of the inverse controller: defaults from the robot's file; weights can change at run time."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Final

from softsim_core.scene import InverseSettings, RobotDescription
from softsim_node import parameter
from softsim_ros import RobotSettings
from softsim_ros.nodes.inverse.plant import FEEDBACKS, Feedback

TASKS: Final = ("position", "orientation", "height_tilt", "pose")
BACKENDS: Final = ("analytic", "sampled")
_LARGEST: Final = 1e9

_OWN: Final = InverseSettings()


@dataclass(frozen=True, kw_only=True)
class ControllerSettings(RobotSettings):
    """Values of the parameters; those of `InverseSettings` have the same names."""

    task: str = parameter(_OWN.task, "What of a goal the effector follows", choices=TASKS)
    backend: str = parameter(
        _OWN.backend,
        "Jacobian by the static tangent, or from sampled equilibria",
        choices=BACKENDS,
        fixed=True,
    )
    rate: float = parameter(
        _OWN.rate,
        "Largest rate at which the error is taken away; less where the robot's slowest period is long",
        unit="1/s",
        within=(1e-3, 1e4),
    )
    gain: float = parameter(
        0.0,
        "Deprecated, see rate: share of the error that one tick takes away; 0.0: rate counts",
        within=(0.0, 1.0),
    )
    feedback_gain: float = parameter(
        _OWN.feedback_gain,
        "Rate at which the model's error against the measured pose is learned",
        unit="1/s",
        within=(0.0, 100.0),
    )
    max_correction: float = parameter(
        _OWN.max_correction, "Largest learned position error", unit="m", within=(0.0, 0.1)
    )
    max_correction_turn: float = parameter(
        _OWN.max_correction_turn, "Largest learned rotation error", unit="rad", within=(0.0, 1.0)
    )
    max_shift: float = parameter(
        _OWN.max_shift,
        "Largest position error along an axis that a tick looks at",
        unit="m",
        within=(1e-5, 1.0),
    )
    max_turn: float = parameter(
        _OWN.max_turn,
        "Largest rotation error about an axis that a tick looks at",
        unit="rad",
        within=(1e-4, 3.2),
    )
    lever: float = parameter(
        _OWN.lever, "Length with which an angle counts as a displacement", unit="m", within=(1e-4, 10.0)
    )
    effort_weight: float = parameter(
        _OWN.effort_weight, "Weight of small joint efforts against tracking", within=(0.0, 1e3)
    )
    posture_weight: float = parameter(
        _OWN.posture_weight, "Weight of staying near the posture against tracking", within=(0.0, 1e3)
    )
    tolerance: float = parameter(
        _OWN.tolerance, "A goal is reached within this distance", unit="m", within=(1e-7, 0.1)
    )
    tolerance_turn: float = parameter(
        _OWN.tolerance_turn, "And within this angle", unit="rad", within=(1e-6, 1.0)
    )
    position_weights: tuple[float, float, float] = parameter(
        _OWN.position_weights, "Weights of the error along world x, y, z", within=(0.0, _LARGEST)
    )
    orientation_weights: tuple[float, float, float] = parameter(
        _OWN.orientation_weights,
        "Weights of the rotation error about world x, y, z",
        within=(0.0, _LARGEST),
    )
    base_shift: float = parameter(
        0.0,
        "Shift of the joint bases if no simulator publishes base_shift: how the robot is mounted",
        unit="m",
        within=(-1.0, 1.0),
    )
    feedback: Feedback = parameter(
        "effector_pose", "Which measured pose corrects the model, where it comes", choices=FEEDBACKS
    )

    @classmethod
    def of(cls, robot: RobotDescription, named: str) -> ControllerSettings:
        """Return the settings of a robot's file; `named` is the value of the parameter `robot`."""
        own = {name: getattr(robot.inverse, name) for name in _list_shared_settings()}
        own["gain"] = robot.inverse.gain or 0.0
        return cls(robot=named, base_shift=robot.start_shift, **own)

    def over(self, own: InverseSettings) -> InverseSettings:
        """Return the settings `own` of control, overridden by these values.

        Raises:
            SoftSimError: they do not fit together.
        """
        shared = {name: getattr(self, name) for name in _list_shared_settings()}
        return dataclasses.replace(own, **{**shared, "gain": self.gain or None})


def _list_shared_settings() -> list[str]:
    """Return the names of the settings of control that are parameters."""
    names = {field.name for field in dataclasses.fields(InverseSettings)}
    return [field.name for field in dataclasses.fields(ControllerSettings) if field.name in names]
