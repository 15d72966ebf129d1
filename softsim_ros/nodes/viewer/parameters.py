"""Parameters of the viewer, and the simulator's parameters that the page can tune."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from softsim_core.physics.fem.materials import MaterialParameter
from softsim_core.scene import RobotDescription
from softsim_node import declare, parameter, parameter_probe
from softsim_ros.keys import DEFAULT_ROBOT, KeySettings
from softsim_ros.nodes.viewer.guard import ViewerError

KILO: Final = 1000.0
MEGA: Final = 1.0e6
SHOWN_IN_MPA: Final = 1.0e7
"""Pressure in [Pa] from which a slider uses [MPa]; paper and thread are above it, rubber below."""

YOUNG_KPA: Final = (10.0, 2000.0)
"""Range of Young modulus in [kPa]; extended if the scene's own value lies outside."""


@dataclass(frozen=True)
class Tunable:
    """A parameter with its control.

    Attributes:
        name: Name of the simulator's parameter.
        label: Words on the page, with the unit that is shown.
        help: Short help text.
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
        """Whether the parameter is a boolean."""
        return isinstance(self.start, bool)

    def si(self, value: Any) -> Any:
        """Return the parameter's value in SI for a displayed value."""
        return bool(value) if self.is_switch else float(value) * self.scale

    def to_displayed(self, value: Any) -> Any:
        """Return the displayed value for a parameter's value, clamped to the range."""
        if self.is_switch:
            return bool(value)
        return min(max(round(float(value) / self.scale, 9), self.lower), self.upper)


def tunables(robot: RobotDescription) -> list[Tunable]:
    """Return speed, limits, materials of bodies, layers and fibres, and damping."""
    scene = robot.scene
    stiffness, mass = scene.solver.rayleigh_stiffness, scene.solver.rayleigh_mass
    found = [
        Tunable("speed", "Speed [× real time]", "0 is as fast as possible", 1.0, upper=4.0, step=0.05),
        Tunable(
            "enforce_limits",
            "Keep joint limits",
            "off allows full turns, in simulation only",
            robot.commands.enforce_limits,
        ),
    ]
    for (owner, values), law in zip(scene.materials, scene.laws, strict=True):
        prefix = scene.parameter_prefix(owner)
        found += [_material_parameter(owner, prefix, own, values[own.name]) for own in law.parameters]
    return [
        *found,
        Tunable(
            "rayleigh_stiffness",
            "Damping per stiffness [s]",
            "takes energy out of deformation",
            stiffness,
            upper=max(0.1, stiffness * 4.0),
            step=0.001,
        ),
        Tunable(
            "rayleigh_mass",
            "Damping per mass [1/s]",
            "slows all motion",
            mass,
            upper=max(20.0, mass * 4.0),
            step=0.1,
        ),
    ]


def _material_parameter(owner: str, prefix: str, parameter: MaterialParameter, value: float) -> Tunable:
    """Return the slider of a material parameter, under the full name of its owner; see SceneDescription."""
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
    scale, unit = 1.0, "" if parameter.unit == "-" else f" [{parameter.unit}]"
    if parameter.unit == "Pa":
        scale, unit = (MEGA, " [MPa]") if abs(value) >= SHOWN_IN_MPA else (KILO, " [kPa]")
    short = parameter.description.partition(",")[0]  # "C1" of "C1, half the shear modulus at rest"
    shown = value / scale
    young = parameter.name == "young_modulus"
    in_fine_steps = young and scale == KILO
    lower, upper = YOUNG_KPA if in_fine_steps else (shown / 10.0, shown * 4.0 or 1.0)
    return Tunable(
        name,
        f"{short} of {whose}{unit}",
        "how stiff the material is" if young else parameter.description,
        shown,
        lower=min(lower, shown / 10.0, shown * 4.0),
        upper=max(upper, shown / 10.0, shown * 4.0),
        step=1.0 if in_fine_steps else 0.01 * abs(shown) or 0.01,
        scale=scale,
    )


DEFAULT_PORT = 8080

TOKEN: Final = "SOFTSIM_PAGE_TOKEN"
TOKEN_FILE: Final = "SOFTSIM_PAGE_TOKEN_FILE"
"""Environment variables with the page's secret, and with the file that contains it.

Other accounts can read neither.
"""

LONGEST_TOKEN: Final = 200
_TOKEN: Final = re.compile(rf"[A-Za-z0-9_-]{{8,{LONGEST_TOKEN}}}")


@dataclass(frozen=True, kw_only=True)
class ViewerSettings:
    """Address and appearance of the page."""

    host: str = parameter("127.0.0.1", "IP address to listen on; 127.0.0.1: this machine only", fixed=True)
    port: int = parameter(DEFAULT_PORT, "TCP port of the page", within=(1, 65535), fixed=True)
    no_token: bool = parameter(False, "No secret: every account here may use the page", fixed=True)
    lite: bool = parameter(False, "Cheap light and no shadows", fixed=True)


@dataclass(frozen=True, kw_only=True)
class TokenSetting:
    """The token as a parameter of a temporary node; others could read it from the viewer's parameters."""

    token: str = parameter("", "Secret that browsers bring; give it in SOFTSIM_PAGE_TOKEN", fixed=True)


def requested_settings() -> tuple[str, ViewerSettings, str]:
    """Return the robot, the settings and the token of this process.

    Raises:
        ViewerError: the file of the token cannot be read, or contains none.
    """
    with parameter_probe("viewer", namespace=DEFAULT_ROBOT) as probe:
        token = declare(probe, TokenSetting()).token
        if token:
            probe.get_logger().warning(
                f"parameter token: every account reads it in the list of processes; give it in {TOKEN} or "
                f"in the file that {TOKEN_FILE} names"
            )
        return (
            declare(probe, KeySettings()).robot,
            declare(probe, ViewerSettings()),
            token or requested_token(os.environ),
        )


def requested_token(environment: Mapping[str, str]) -> str:
    """Return the secret that browsers must send, from the environment or from a file that it names.

    An empty string asks for a new one.

    Raises:
        ViewerError: the file cannot be read, or contains no token.
    """
    if token := environment.get(TOKEN, "").strip():
        return _usable(token, TOKEN)
    if not (name := environment.get(TOKEN_FILE, "")):
        return ""
    try:
        with Path(name).expanduser().open("rb") as stream:
            data = stream.read(LONGEST_TOKEN + 2)
    except OSError as error:
        raise ViewerError(f"viewer: {TOKEN_FILE} names {name}: {error.strerror}") from error
    return _usable(data.decode(errors="replace").strip(), name)


def _usable(token: str, source: str) -> str:
    if not _TOKEN.fullmatch(token):
        raise ViewerError(
            f"viewer: {source} holds no token; one has 8 to {LONGEST_TOKEN} letters, digits, '_' and '-'"
        )
    return token
