"""Parameters of the simulator that can be tuned while it runs, with the ranges of their sliders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from softsim_core.scene.description import SceneDescription

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


def tunables(scene: SceneDescription) -> list[Tunable]:
    """Speed, limits, material of each body, damping."""
    found = [
        Tunable(
            "speed", "Speed [× real time]", "0 is as fast as possible", 1.0, lower=0.0, upper=4.0, step=0.05
        ),
        Tunable(
            "enforce_limits",
            "Keep joint limits",
            "off allows full turns, in simulation only",
            scene.commands.enforce_limits,
        ),
    ]
    for body in scene.bodies:
        prefix = f"{body.name}." if len(scene.bodies) > 1 else ""
        young = body.material.young_modulus / KILO
        found.append(
            Tunable(
                f"{prefix}young_modulus",
                f"Young modulus of {body.name} [kPa]",
                "how stiff the material is",
                young,
                lower=min(YOUNG_KPA[0], young / 10.0),
                upper=max(YOUNG_KPA[1], young * 4.0),
                step=1.0,
                scale=KILO,
            )
        )
        found.append(
            Tunable(
                f"{prefix}poisson_ratio",
                f"Poisson ratio of {body.name}",
                "0.5 keeps the volume",
                body.material.poisson_ratio,
                lower=min(0.0, body.material.poisson_ratio),
                upper=max(0.495, body.material.poisson_ratio),
                step=0.005,
            )
        )
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
