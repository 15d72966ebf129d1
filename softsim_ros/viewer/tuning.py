"""Parameters of the simulator that can be tuned while it runs, with the ranges of their sliders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from softsim_core.fem.materials import MaterialParameter
from softsim_core.scene.robot import RobotDescription

KILO: Final = 1000.0
MEGA: Final = 1.0e6
SHOWN_IN_MPA: Final = 1.0e7
"""From this pressure in [Pa] on a slider shows [MPa]: paper and thread, not rubber."""

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
    """Speed, limits, material of each body, of its layers and its fibres, damping."""
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
    for (owner, values), law in zip(scene.materials, scene.laws, strict=True):
        prefix = scene.parameter_prefix(owner)
        for parameter in law.parameters:
            found.append(_material_parameter(owner, prefix, parameter, values[parameter.name]))
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


def _material_parameter(owner: str, prefix: str, parameter: MaterialParameter, value: float) -> Tunable:
    """The slider of a parameter of a law, by the full name of what is made of it; see SceneDescription."""
    name, whose = f"{prefix}{parameter.name}", prefix.rstrip(".") or owner
    if parameter.name == "poisson_ratio":
        return Tunable(
            name,
            f"Poisson ratio of {whose}",
            "0.5 keeps the volume",
            value,
            lower=min(0.0, value),
            upper=max(0.495, value),
            step=0.005,
        )
    scale, unit = _shown_unit(parameter.unit, value)
    shown = value / scale
    young = parameter.name == "young_modulus"
    in_fine_steps = young and scale == KILO
    lower, upper = YOUNG_KPA if in_fine_steps else (shown / 10.0, shown * 4.0 or 1.0)
    return Tunable(
        name,
        f"{_in_short(parameter)} of {whose}{unit}",
        "how stiff the material is" if young else parameter.description,
        shown,
        lower=min(lower, shown / 10.0, shown * 4.0),
        upper=max(upper, shown / 10.0, shown * 4.0),
        step=1.0 if in_fine_steps else 0.01 * abs(shown) or 0.01,
        scale=scale,
    )


def _shown_unit(unit: str, value: float) -> tuple[float, str]:
    """How many of SI are one of the shown unit, and how a label ends with it."""
    if unit != "Pa":
        return 1.0, "" if unit == "-" else f" [{unit}]"
    return (MEGA, " [MPa]") if abs(value) >= SHOWN_IN_MPA else (KILO, " [kPa]")


def _in_short(parameter: MaterialParameter) -> str:
    """What a label calls it: "C1" of "C1, half the shear modulus at rest", which its help says whole."""
    return parameter.description.partition(",")[0]
