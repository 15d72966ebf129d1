"""The words of what can be switched on the page, by the fields of a scene's view."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

LAYERS: Final[Mapping[str, str]] = {
    "stress": "Stress colours",
    "bodies": "Bodies",
    "ghost": "Bodies at rest",
    "trail": "Way of the effector",
    "wireframe": "Wire frame",
    "normals": "Normals",
    "elements": "Finite elements",
    "nodes": "Nodes",
    "regions": "Rigid regions and fixings",
    "boxes": "Boxes and spheres that select nodes",
    "frames": "Frames",
    "arms": "Servo arms",
    "labels": "Labels",
    "cables": "Cables",
    "chambers": "Pressure chambers",
    "contacts": "Contacts and forces",
    "rigid": "Rigid bodies",
    "collisions": "Collision surfaces",
    "search_boxes": "Boxes of the contact search",
}
