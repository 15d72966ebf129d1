"""Write a robot as URDF: links, joints with limits, visuals, and the topics of ros2_control.

Lengths are in metres. URDF requires a bound of every effort; if none is known it is UNKNOWN_EFFORT. The
masses belong to the silicone and not to the links. Because simulators refuse a moving link without mass, each
link is a small solid ball of LINK_MASS.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from softsim_core import RobotDescription
from softsim_core.base import Array, MeshFile
from softsim_core.physics.mechanics import euler_of, rotation_euler
from softsim_core.physics.mesh import Shape
from softsim_core.scene import JointDescription
from softsim_node import BASE_LINK
from softsim_ros.description.links import Link, links_of, moved_link

UNKNOWN_EFFORT: Final = 1000.0
"""Bound in [N m] or [N] of an effort without a known bound."""

FARTHEST: Final = 1000.0
"""Bound in [m] of a slide's position without a bound."""

LINK_MASS: Final = 1.0e-3
"""Mass in [kg] of every link except the base."""

LINK_RADIUS: Final = 0.01
"""Radius in [m] of the ball that gives a link its inertia."""

SHOWN_SUFFIXES: Final = (".stl", ".obj", ".dae")
"""Mesh file types that programs which read URDF can display."""

HARDWARE_PLUGIN: Final = "joint_state_topic_hardware_interface/JointStateTopicSystem"

MeshNames = Callable[[str, MeshFile | None], tuple[str, MeshFile | None] | None]
"""Returns the address and the placement of a mesh, given a part (KIND/NAME) and its file; None: no visual."""


@dataclass(frozen=True, slots=True)
class ControlTopics:
    """Topics through which ros2_control's topic hardware interface reaches the robot.

    Attributes:
        commands: Topic of its commands.
        states: Topic of the joint states that it reads.
    """

    commands: str
    states: str


def mesh_address(part: str, mesh: MeshFile | None) -> tuple[str, MeshFile | None] | None:
    """Return the address of a mesh: `package://` in the share folder of a ROS package, else `file://`."""
    if mesh is None or mesh.file.suffix.lower() not in SHOWN_SUFFIXES:
        return None
    for folder in mesh.file.parents:
        if folder.parent.name == "share" and (folder / "package.xml").is_file():
            return f"package://{folder.name}/{mesh.file.relative_to(folder).as_posix()}", mesh
    return mesh.file.absolute().as_uri(), mesh


def control_topics(namespace: str) -> ControlTopics:
    """Return the topics of a robot's simulator."""
    start = f"/{namespace.strip('/')}/" if namespace.strip("/") else "/"
    return ControlTopics(f"{start}joint_commands", f"{start}joint_states")


def urdf(
    robot: RobotDescription, *, topics: ControlTopics | None = None, meshes: MeshNames = mesh_address
) -> str:
    """Return the URDF text of a robot, with a section `ros2_control` if its topics are given.

    `meshes` returns the address of each mesh.
    """
    root = ElementTree.Element("robot", name=robot.name)
    ElementTree.SubElement(root, "link", name=BASE_LINK)
    joints = {joint.name: joint for joint in robot.joints}
    for link in links_of(robot):
        _add_link(root, link, robot, meshes)
        _add_joint(root, link, joints.get(link.joint))
    if topics is not None and robot.joints:
        _add_control(root, robot, topics)
    ElementTree.indent(root)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _add_joint(root: ElementTree.Element, link: Link, joint: JointDescription | None) -> None:
    element = ElementTree.SubElement(root, "joint", name=link.joint, type=link.kind)
    ElementTree.SubElement(element, "parent", link=link.parent)
    ElementTree.SubElement(element, "child", link=link.name)
    _add_origin(element, link.position, link.rotation)
    if joint is None:
        return
    ElementTree.SubElement(element, "axis", xyz=_words(link.axis))
    limits, bounds = joint.limits, dict[str, str]()
    if link.kind != "continuous":
        bounds = {
            "lower": _number(max(limits.lower, -FARTHEST)),
            "upper": _number(min(limits.upper, FARTHEST)),
        }
    effort = getattr(joint.actuator, "max_tension", None) or UNKNOWN_EFFORT
    speed = limits.speed if math.isfinite(limits.speed) else FARTHEST
    bounds |= {"effort": _number(effort), "velocity": _number(speed)}
    ElementTree.SubElement(element, "limit", bounds)


def _add_link(root: ElementTree.Element, link: Link, robot: RobotDescription, meshes: MeshNames) -> None:
    element = ElementTree.SubElement(root, "link", name=link.name)
    inertial = ElementTree.SubElement(element, "inertial")
    ElementTree.SubElement(inertial, "mass", value=_number(LINK_MASS))
    moment = f"{0.4 * LINK_MASS * LINK_RADIUS**2:g}"
    moments = {f"i{a}{b}": moment if a == b else "0" for a, b in ("xx", "xy", "xz", "yy", "yz", "zz")}
    ElementTree.SubElement(inertial, "inertia", moments)
    kind, _, name = link.part.partition("/")
    scene = robot.scene
    if kind == "joints":
        joint = next(each for each in scene.joints if each.name == name)
        if link.name == moved_link(joint) and joint.moves_frame and joint.horn_length > 0.0:
            _add_horn(element, joint)
    elif kind == "rigid_bodies":
        rigid = next(each for each in scene.rigid_bodies if each.name == name)
        _add_shape(element, link.part, rigid.shape, rigid.colour, meshes)
    elif kind == "bodies":
        soft = next(each for each in scene.bodies if each.name == name)
        _add_mesh(element, link.part, soft.surface, soft.colour, meshes)


def _add_horn(link: ElementTree.Element, joint: JointDescription) -> None:
    """Add the servo's arm along z as a visual."""
    length = joint.horn_length
    place = np.array([0.0, 0.0, 0.5 * length])
    geometry = _visual(link, joint.name, (0.2, 0.2, 0.2, 1.0), place, np.eye(3))
    size = np.array([0.08 * length, 0.32 * length, length])
    ElementTree.SubElement(geometry, "box", size=_words(size))


def _add_shape(
    link: ElementTree.Element, part: str, shape: Shape, colour: Sequence[float], meshes: MeshNames
) -> None:
    if shape.mesh is not None:
        _add_mesh(link, part, shape.mesh, colour, meshes)
        return
    geometry = _visual(link, part, colour, np.zeros(3), np.eye(3))
    if shape.sphere is not None:
        ElementTree.SubElement(geometry, "sphere", radius=_number(shape.sphere))
    elif shape.cylinder is not None:
        radius, height = shape.cylinder
        ElementTree.SubElement(geometry, "cylinder", radius=_number(radius), length=_number(height))
    else:
        flat = (*shape.plane, 1e-4) if shape.plane is not None else None
        ElementTree.SubElement(geometry, "box", size=_words(np.array(shape.box or flat)))


def _add_mesh(
    link: ElementTree.Element, part: str, mesh: MeshFile | None, colour: Sequence[float], meshes: MeshNames
) -> None:
    found = meshes(part, mesh)
    if found is None:
        return
    address, placed = found
    position, rotation, scale = np.zeros(3), np.eye(3), 1.0
    if placed is not None:
        position = np.array(placed.placement.translation, dtype=float)
        rotation = rotation_euler(np.radians(placed.placement.rotation_deg))
        scale = placed.placement.scale
    geometry = _visual(link, part, colour, position, rotation)
    ElementTree.SubElement(geometry, "mesh", filename=address, scale=_words(np.full(3, scale)))


def _visual(
    link: ElementTree.Element, name: str, colour: Sequence[float], position: Array, rotation: Array
) -> ElementTree.Element:
    """Add a visual to a link and return its geometry."""
    visual = ElementTree.SubElement(link, "visual")
    _add_origin(visual, position, rotation)
    geometry = ElementTree.SubElement(visual, "geometry")
    material = ElementTree.SubElement(visual, "material", name=name.replace("/", "_"))
    ElementTree.SubElement(material, "color", rgba=_words(np.array(colour)))
    return geometry


def _add_control(root: ElementTree.Element, robot: RobotDescription, topics: ControlTopics) -> None:
    system = ElementTree.SubElement(root, "ros2_control", name=robot.name, type="system")
    hardware = ElementTree.SubElement(system, "hardware")
    ElementTree.SubElement(hardware, "plugin").text = HARDWARE_PLUGIN
    for name, value in (
        ("joint_commands_topic", topics.commands),
        ("joint_states_topic", topics.states),
        ("trigger_joint_command_threshold", "-1"),  # always: a bridge brakes where commands stop
    ):
        ElementTree.SubElement(hardware, "param", name=name).text = value
    for joint in robot.joints:
        element = ElementTree.SubElement(system, "joint", name=joint.name)
        ElementTree.SubElement(element, "command_interface", name="position")
        for state in ("position", "velocity", "effort"):
            ElementTree.SubElement(element, "state_interface", name=state)


def _add_origin(element: ElementTree.Element, position: Array, rotation: Array) -> None:
    ElementTree.SubElement(element, "origin", xyz=_words(position), rpy=_words(euler_of(rotation)))


def _words(values: Array) -> str:
    return " ".join(_number(float(value)) for value in values)


def _number(value: float) -> str:
    """Return a number as text, with the fewest digits that represent it and no negative zero."""
    return repr(float(np.round(value, 12)) + 0.0)
