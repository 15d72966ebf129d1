"""Regions of bodies, and the attachments that hold and move them; typed, SI."""

from __future__ import annotations

import math
from dataclasses import dataclass

from softsim_core.errors import SceneError
from softsim_core.scene.rod import RodEnd
from softsim_core.values import Box, Placement, Sphere


def need_one_region(owner: str, *given: Box | Sphere | RodEnd | str | None) -> None:
    """Refuse none, or more than one, of a region's box, sphere, end of a rod and group.

    Raises:
        SceneError: names the owner.
    """
    if sum(each is not None for each in given) != 1:
        raise SceneError(f"{owner}: give exactly one of box, sphere, end and group")


@dataclass(frozen=True, slots=True, kw_only=True)
class AttachmentDescription:
    """A region of a body that moves rigidly: with the world, with a joint, or as a free rigid frame.

    Attributes:
        name: Unique name; a free frame carries this name.
        body: Name of the body.
        to: "world" (held still), "free" (a rigid frame with six unknowns), the name of a joint, or that of an
            attachment with to = free, whose frame then carries both.
        box, sphere: The region; nodes are chosen once, on the rest shape, of a rod whole sections.
        end: Or that end of a rod, beyond its clamp where it has one.
        group: Or the name of a group of the mesh's file: a physical group of Gmsh, of points, lines, faces or
            cells. Exactly one of the four.
        relative_to: None: the region is given in world coordinates. A joint name: in that joint's base frame.
        frame: Origin in [m] and orientation of a free frame, in world coordinates. None: the origin is the
            mean of its nodes at rest, the axes are those of the world.
        stiffness: Only with to = "world": spring in [N/m] a node instead of an exact hold.
    """

    name: str
    body: str
    to: str
    box: Box | None = None
    sphere: Sphere | None = None
    end: RodEnd | None = None
    group: str | None = None
    relative_to: str | None = None
    frame: Placement | None = None
    stiffness: float | None = None

    def __post_init__(self) -> None:
        need_one_region(f"attachment {self.name}", self.box, self.sphere, self.end, self.group)
        if self.stiffness is not None and (self.to != "world" or not 0.0 < self.stiffness < math.inf):
            raise SceneError(f"attachment {self.name}: stiffness needs to = world and a value > 0 N/m")
