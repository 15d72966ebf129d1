"""The policy node's parameters."""

from __future__ import annotations

from dataclasses import dataclass

from softsim_node.parameters import parameter
from softsim_ros.robot_node import RobotSettings


@dataclass(frozen=True, kw_only=True)
class PolicyParameters(RobotSettings):
    """Values of the parameters."""

    policy: str = parameter("", "ONNX file of the policy", fixed=True)
    enabled: bool = parameter(False, "Switch it on as soon as all that it looks at was heard", fixed=True)
    measure_timeout: float = parameter(
        0.2,
        "What is older is not used: the command stays what it was",
        unit="s",
        within=(0.01, 60.0),
        fixed=True,
    )
