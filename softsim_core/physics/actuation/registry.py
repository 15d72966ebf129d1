"""Registry of actuator kinds: those of the package, and those that users register."""

from __future__ import annotations

from collections.abc import Callable

from softsim_core.base import SceneError, listing
from softsim_core.physics.actuation.actuators import Actuator
from softsim_core.physics.actuation.building import (
    ActuatorDescription,
    ActuatorKind,
    Placed,
    Surroundings,
    plain_kind,
)
from softsim_core.physics.actuation.cable import CABLE
from softsim_core.physics.actuation.chamber import CHAMBER
from softsim_core.physics.actuation.joint_drive import JOINT_DRIVE
from softsim_core.physics.actuation.load import LOAD

FRAME_KINDS = ("revolute", "prismatic")
"""Kinds of joints that move a frame; their actuator is a joint drive."""

_kinds: dict[str, ActuatorKind] = {kind.name: kind for kind in (JOINT_DRIVE, CABLE, CHAMBER, LOAD)}


def register_actuator(
    description: type[ActuatorDescription], build: Callable[[Placed, Surroundings], Actuator]
) -> None:
    """Register a kind of plain actuators under the `kind` of its description.

    An earlier kind of the same name is replaced.

    Args:
        description: A frozen dataclass derived from ActuatorDescription; scene files give its fields under
            the key named after the kind.
        build: Builds the actuator of one joint from its description.

    Raises:
        SceneError: the name is that of a built-in kind or of a joint kind, or no identifier.
    """
    name, built_in = description.kind, (*FRAME_KINDS, JOINT_DRIVE.name, CABLE.name, CHAMBER.name, LOAD.name)
    if not name.isidentifier() or name in built_in:
        raise SceneError(f"actuator kind {name!r} refused: it must be a word other than {listing(built_in)}")
    _kinds[name] = plain_kind(description, build)


def actuator_kinds() -> dict[str, ActuatorKind]:
    """Return all kinds by name, in the order in which they were registered."""
    return dict(_kinds)


def described_kinds() -> dict[str, type[ActuatorDescription]]:
    """Return the types of the descriptions of all kinds that have one, by name."""
    return {name: kind.description for name, kind in _kinds.items() if kind.description is not None}
