"""The inverse controller's parameters: defaults from the robot's file, weights change at run time."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.node import Node
from rclpy.parameter import Parameter

from softsim_core.scene.control import InverseSettings
from softsim_core.scene.robot import RobotDescription
from softsim_node.parameters import ParameterError
from softsim_ros.inverse.plant import FEEDBACKS, Feedback
from softsim_ros.runtime import declare_number, declare_text

TASKS: Final = ("position", "orientation", "height_tilt", "pose")
BACKENDS: Final = ("analytic", "sampled")

NUMBERS: Final = {
    "gain": ("Share of the error that one tick takes away", 1e-3, 1.0),
    "feedback_gain": (
        "Rate in 1/s at which the model's error against the measured pose is learned",
        0.0,
        100.0,
    ),
    "max_correction": ("Largest learned position error in m", 0.0, 0.1),
    "max_correction_turn": ("Largest learned rotation error in rad", 0.0, 1.0),
    "max_shift": ("Largest position error in m along an axis that a tick looks at", 1e-5, 1.0),
    "max_turn": ("Largest rotation error in rad about an axis that a tick looks at", 1e-4, 3.2),
    "lever": ("Length in m with which an angle counts as a displacement", 1e-4, 10.0),
    "effort_weight": ("Weight of small joint efforts against tracking", 0.0, 1e3),
    "posture_weight": ("Weight of staying near the posture against tracking", 0.0, 1e3),
    "tolerance": ("A goal is reached within this distance in m", 1e-7, 0.1),
    "tolerance_turn": ("And within this angle in rad", 1e-6, 1.0),
}
"""Settings that are numbers: description and range."""

WEIGHTS: Final = {
    "position_weights": "Weights of the error along world x, y, z; three numbers >= 0",
    "orientation_weights": "Weights of the rotation error about world x, y, z; three numbers >= 0",
}


@dataclass(frozen=True, slots=True)
class StartParameters:
    """Values at start: the robot with the settings laid over it, and where feedback comes from."""

    robot: RobotDescription
    feedback: Feedback


def declare_parameters(node: Node, robot: RobotDescription) -> StartParameters:
    """Declare all parameters but `robot`; defaults come from the robot's file, key `inverse`.

    Raises:
        ParameterError: a value given at start is not allowed.
        SceneError: values that do not fit together.
    """
    own = robot.inverse
    values: dict[str, Any] = {
        "task": declare_text(
            node, "task", own.task, "What of a goal the effector follows", choices=TASKS, read_only=False
        ),
        "backend": declare_text(
            node, "backend", own.backend, "Jacobian by the static tangent, or from sampled equilibria",
            choices=BACKENDS,
        ),
    }  # fmt: skip
    for name, (description, lower, upper) in NUMBERS.items():
        values[name] = declare_number(node, name, getattr(own, name), description, lower, upper)
    for name, description in WEIGHTS.items():
        values[name] = _declare_weights(node, name, getattr(own, name), description)
    declare_number(
        node,
        "base_shift",
        robot.start_shift,
        "Shift in m of the joint bases where no simulator tells it on base_shift: how the robot is mounted",
        -1.0,
        1.0,
    )
    feedback = declare_text(
        node, "feedback", "effector_pose", "Which measured pose corrects the model, where it comes",
        choices=FEEDBACKS, read_only=False,
    )  # fmt: skip
    settings = dataclasses.replace(own, **values)
    return StartParameters(dataclasses.replace(robot, inverse=settings), checked_feedback(feedback))


def tuned(settings: InverseSettings, parameters: Sequence[Parameter]) -> InverseSettings:
    """The settings with new values of those parameters that are settings; the others are left out.

    Raises:
        SoftSimError: a value is not allowed.
    """
    values: dict[str, Any] = {}
    for parameter in parameters:
        if parameter.name in NUMBERS:
            values[parameter.name] = float(parameter.value)
        elif parameter.name in WEIGHTS:
            values[parameter.name] = _three(parameter.name, parameter.value)
        elif parameter.name == "task":
            if parameter.value not in TASKS:
                raise ParameterError(f"task {parameter.value!r} is refused; allowed is {', '.join(TASKS)}")
            values["task"] = parameter.value
    return dataclasses.replace(settings, **values)


def checked_feedback(value: object) -> Feedback:
    """Where feedback comes from.

    Raises:
        ParameterError: not one of FEEDBACKS.
    """
    for known in FEEDBACKS:
        if value == known:
            return known
    raise ParameterError(f"feedback {value!r} is refused; allowed is {', '.join(FEEDBACKS)}")


def _declare_weights(
    node: Node, name: str, default: Sequence[float], description: str
) -> tuple[float, float, float]:
    try:
        value = node.declare_parameter(
            name, [float(each) for each in default], ParameterDescriptor(description=description)
        ).value
    except InvalidParameterTypeException as error:
        raise ParameterError(
            f"parameter {name} has the wrong type; allowed are three numbers written with decimal points, "
            "such as [1.0, 1.0, 0.0]"
        ) from error
    return _three(name, value)


def _three(name: str, value: Sequence[float]) -> tuple[float, float, float]:
    if len(value) != 3:
        raise ParameterError(f"parameter {name} has {len(value)} values; allowed are three numbers >= 0")
    x, y, z = map(float, value)
    return x, y, z
