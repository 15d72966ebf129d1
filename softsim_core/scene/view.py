"""Initial view of a scene: layers, parts, stress colours, camera; typed, SI."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Literal, TypeAlias, get_args

from softsim_core.base import FieldError, SceneError, Vector, need_finite, need_positive

StressMap: TypeAlias = Literal["viridis", "inferno", "coolwarm"]
"""A colour map with perceptually even steps."""
STRESS_MAPS: tuple[StressMap, ...] = get_args(StressMap)


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A plane that cuts bodies open: points beyond `at` in [m] along the world's `axis` are not drawn."""

    axis: Literal["x", "y", "z"]
    at: float = 0.0

    def __post_init__(self) -> None:
        need_finite("section", "at", (self.at,))


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """The camera's `position`, and the `target` it looks at and rotates about, in [m]; z is up."""

    position: Vector
    target: Vector

    def __post_init__(self) -> None:
        need_finite("camera", "position", self.position)
        need_finite("camera", "target", self.target)
        if not math.dist(self.position, self.target) > 1e-6:
            raise SceneError("camera: position and target are the same point; move one of them")


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewSettings:
    """Initial view of a page; each layer can be switched there afterwards.

    Attributes:
        bodies: Visible surfaces of the deformable bodies.
        wireframe: These surfaces as wire frames.
        normals: Normals of these surfaces.
        stress: These surfaces coloured by von Mises stress.
        elements: Finite elements.
        nodes: Nodes, the unknowns of the bodies, as squares.
        regions: Nodes of rigid regions and fixings, with one colour each.
        boxes: Boxes and spheres that select nodes.
        frames: Frames of joints and free rigid regions, and of rigid bodies.
        arms: Servos and their arms.
        labels: Names of the servos.
        cables: Cables, their points and pull points.
        tensions: Cables coloured by their tension.
        chambers: Pressure chambers; they are visible through bodies whose colour has an alpha below 1.
        contacts: Contacts and their forces.
        rigid: Rigid bodies.
        collisions: Collision surfaces.
        search_boxes: A box around each of these surfaces; contact is searched only where two boxes are nearer
            than the alarm distance.
        ghost: The bodies at rest, faintly.
        trail: Past path of the effector.
        hidden: Hidden parts, each as KIND/NAME: bodies/silicone, joints/servo_0, attachments/...,
            rigid_bodies/..., collisions/....
        stress_map: Colours of the stress.
        stress_top: Stress in [Pa] of the last colour, > 0; None: the largest stress.
        section: Plane that cuts bodies open; None: none.
        node_size: Size in [m] at which nodes are drawn, > 0.
        camera: Initial camera; None: all bodies are in view.
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
    tensions: bool = False
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
"""Names of the layers that can be switched."""
