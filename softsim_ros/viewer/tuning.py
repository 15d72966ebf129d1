"""Parameters of the simulator that can be tuned while it runs, with the ranges of their sliders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from softsim_core.fem.materials import MaterialParameter
from softsim_core.scene.description import BodyDescription
from softsim_core.scene.robot import RobotDescription

KILO: Final = 1000.0
YOUNG_KPA: Final = (10.0, 2000.0)
"""Range of Young modulus in [kPa]; wider where the scene's own lies outside."""


@dataclass(frozen=True)
class Tunable:
    """A parameter with its control.

    Attributes:
        name: Name of the simulator's parameter.
        label: Words on the page, with the unit that is shown.
        help: One sentence.
        start: Value at the start, as shown.
        lower, upper, step: Range of the slider, as shown.
        scale: SI value of one shown unit.
    """

    name: str
    label: str
    help: str
    start: float | bool
    lower: float = 0.0
    upper: float = 1.0
    step: float = 0.01
    scale: float = 1.0

    @property
    def is_switch(self) -> bool:
        """Whether it is true or false."""
        return isinstance(self.start, bool)

    def si(self, value: Any) -> Any:
        """The parameter's value for what the control shows."""
        return bool(value) if self.is_switch else float(value) * self.scale

    def shown(self, value: Any) -> Any:
        """What the control shows for a parameter's value, within its range."""
        if self.is_switch:
            return bool(value)
        return min(max(round(float(value) / self.scale, 9), self.lower), self.upper)


def tunables(robot: RobotDescription) -> list[Tunable]:
    """Speed, limits, material of each body, damping."""
    scene = robot.scene
    found = [
        Tunable(
            "speed", "Speed [× real time]", "0 is as fast as possible", 1.0, lower=0.0, upper=4.0, step=0.05
        ),
        Tunable(
            "enforce_limits",
            "Keep joint limits",
            "off allows full turns, in simulation only",
            robot.commands.enforce_limits,
        ),
    ]
    for body in scene.bodies:
        prefix = f"{body.name}." if len(scene.bodies) > 1 else ""
        for parameter in body.material.law_for(scene.solver.rotation).parameters:
            found.append(_material_parameter(body, parameter, prefix))
    found.append(
        Tunable(
            "rayleigh_stiffness",
            "Damping per stiffness [s]",
            "takes energy out of deformation",
            scene.solver.rayleigh_stiffness,
            lower=0.0,
            upper=max(0.1, scene.solver.rayleigh_stiffness * 4.0),
            step=0.001,
        )
    )
    found.append(
        Tunable(
            "rayleigh_mass",
            "Damping per mass [1/s]",
            "slows all motion",
            scene.solver.rayleigh_mass,
            lower=0.0,
            upper=max(20.0, scene.solver.rayleigh_mass * 4.0),
            step=0.1,
        )
    )
    return found


def _material_parameter(body: BodyDescription, parameter: MaterialParameter, prefix: str) -> Tunable:
    """The slider of a parameter of a body's law; pressures are shown in [kPa]."""
    value, name = body.material.values[parameter.name], parameter.name
    if name == "poisson_ratio":
        return Tunable(
            f"{prefix}{name}",
            f"Poisson ratio of {body.name}",
            "0.5 keeps the volume",
            value,
            lower=min(0.0, value),
            upper=max(0.495, value),
            step=0.005,
        )
    scale, unit = (KILO, "kPa") if parameter.unit == "Pa" else (1.0, parameter.unit)
    young = name == "young_modulus"
    shown = value / scale
    lower, upper = YOUNG_KPA if young else (shown / 10.0, shown * 4.0 or 1.0)
    return Tunable(
        f"{prefix}{name}",
        f"{parameter.description} of {body.name} [{unit}]",
        "how stiff the material is" if young else parameter.description,
        shown,
        lower=min(lower, shown / 10.0, shown * 4.0),
        upper=max(upper, shown / 10.0, shown * 4.0),
        step=1.0 if young else 0.01 * abs(shown) or 0.01,
        scale=scale,
    )
