"""What a scene shows of itself when it begins: layers, parts, stress colours, camera; typed, SI."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Literal, TypeAlias, get_args

from softsim_core.base import FieldError, SceneError, Vector, need_finite, need_positive

StressMap: TypeAlias = Literal["viridis", "inferno", "coolwarm"]
"""A colour map: even steps of it look even."""
STRESS_MAPS: tuple[StressMap, ...] = get_args(StressMap)


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A plane that cuts bodies open: what lies beyond `at` in [m] along the world's `axis` is not drawn."""

    axis: Literal["x", "y", "z"]
    at: float = 0.0

    def __post_init__(self) -> None:
        need_finite("section", "at", (self.at,))


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """Where the camera is: `position`, and the `target` it looks at and turns about, in [m]; z is up."""

    position: Vector
    target: Vector

    def __post_init__(self) -> None:
        need_finite("camera", "position", self.position)
        need_finite("camera", "target", self.target)
        if not math.dist(self.position, self.target) > 1e-6:
            raise SceneError("camera: position and target are the same point; move one of them")


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewSettings:
    """What a page shows when the scene begins; each layer can be switched there afterwards.

    Attributes:
        bodies: Visible surfaces of the deformable bodies.
        wireframe: These surfaces as wire frames.
        normals: Directions in which these surfaces face.
        stress: These surfaces coloured by von Mises stress.
        elements: Finite elements.
        nodes: Nodes, the unknowns of the bodies, as squares.
        regions: Nodes of rigid regions and fixings, a colour each.
        boxes: Boxes and spheres that select nodes.
        frames: Frames of joints and free rigid regions, and of rigid bodies.
        arms: Servos and their arms.
        labels: Names of the servos.
        cables: Cables, their points and pull points.
        chambers: Pressure chambers; they are seen through bodies whose colour has an alpha below 1.
        contacts: Contacts and their forces.
        rigid: Rigid bodies.
        collisions: Surfaces that contact looks at.
        search_boxes: A box around each of these surfaces; contact is looked for only where two boxes come
            nearer than the alarm distance.
        ghost: The bodies as they are at rest, faintly.
        trail: The way that the effector has come.
        hidden: Parts that are not shown, each as KIND/NAME: bodies/silicone, joints/servo_0, attachments/...,
            rigid_bodies/..., collisions/....
        stress_map: Colours of the stress.
        stress_top: Stress in [Pa] of the last colour, > 0; None: the largest there is.
        section: Where bodies are cut open; None: nowhere.
        node_size: Size in [m] at which nodes are drawn, > 0.
        camera: Where the camera starts; None: where it sees all bodies.
    """

    bodies: bool = True
    wireframe: bool = False
    normals: bool = False
    stress: bool = False
    elements: bool = False
    nodes: bool = False
    regions: bool = False
    boxes: bool = False
    frames: bool = False
    arms: bool = True
    labels: bool = True
    cables: bool = True
    chambers: bool = True
    contacts: bool = True
    rigid: bool = True
    collisions: bool = False
    search_boxes: bool = False
    ghost: bool = False
    trail: bool = False
    hidden: tuple[str, ...] = ()
    stress_map: StressMap = "viridis"
    stress_top: float | None = None
    section: Section | None = None
    node_size: float = 0.0009
    camera: Camera | None = None

    def __post_init__(self) -> None:
        if self.stress_top is not None:
            need_positive("view", "stress_top", self.stress_top, "Pa (or absent)")
        need_positive("view", "node_size", self.node_size, "m")
        if len(set(self.hidden)) != len(self.hidden):
            raise FieldError("view", "hidden", list(self.hidden), "a list without repetition")


LAYERS: tuple[str, ...] = tuple(each.name for each in fields(ViewSettings) if each.type == "bool")
"""Names of what can be switched."""
