"""Rigid robots in URDF files: links, their shapes, and the joints between them.

Source: the URDF specification of ROS (wiki.ros.org/urdf/XML); parsed by ROS 2's own urdfdom_py.
"""

from __future__ import annotations

import importlib
import math
import warnings
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from softsim_core.arrays import Array
from softsim_core.errors import ConfigError, SceneError, listing
from softsim_core.extras import install_command
from softsim_core.mechanics.limits import JointLimits
from softsim_core.mechanics.pose import rotation_euler
from softsim_core.mesh.shapes import Shape
from softsim_core.scene.arm.packages import not_found, package_folders
from softsim_core.scene.arm.xacro_file import expanded
from softsim_core.scene.placed import Motion
from softsim_core.scene.programs import XACRO
from softsim_core.values import MeshFile, Placement
from softsim_core.wrong_names import known_names

MOST_BYTES: Final = 10_000_000
"""A larger file is refused before it is parsed."""
MOST_JOINTS: Final = 1000
MESHES: Final = (".stl", ".obj", ".ply")
"""File types of meshes that are read."""
GREY: Final = (0.6, 0.62, 0.65, 1.0)
"""Colour of what has none."""


@dataclass(frozen=True, slots=True, eq=False)
class LinkShape:
    """A shape of a link: where it sits in the link's frame, red, green, blue, alpha; whether it touches."""

    shape: Shape
    pose: Motion
    colour: tuple[float, float, float, float]
    touches: bool


@dataclass(frozen=True, slots=True, eq=False)
class UrdfJoint:
    """A joint: its frame in the parent link's at position 0, which is that of the child link.

    Attributes:
        name, kind: Its name; "revolute", "prismatic" or "fixed".
        parent, child: Links.
        origin: Its frame in that of the parent.
        axis: Unit axis in its frame, shape (3,).
        limits: Interval in [rad] or [m] and top speed.
    """

    name: str
    kind: str
    parent: str
    child: str
    origin: Motion
    axis: Array
    limits: JointLimits


@dataclass(frozen=True, slots=True, eq=False)
class RigidRobot:
    """A tree of links.

    Attributes:
        name: Of the robot.
        root: The link that nothing carries.
        shapes: Of each link.
        joints: Parents before children.
    """

    name: str
    root: str
    shapes: dict[str, tuple[LinkShape, ...]]
    joints: tuple[UrdfJoint, ...]

    @property
    def last_link(self) -> str:
        """The link at the end of the longest chain of joints; of several, that of the last joint."""
        depth = {self.root: 0}
        for each in self.joints:
            depth[each.child] = depth[each.parent] + 1
        return max(reversed(depth), key=lambda link: depth[link])


def read_urdf(file: Path, arguments: Mapping[str, str] | None = None) -> RigidRobot:
    """A rigid robot of a URDF file, or of a xacro file, which is expanded.

    Joints that follow others (`mimic`) stay at 0, and meshes of other types than MESHES are left out: each
    with a warning.

    Args:
        file: The file.
        arguments: Those of a xacro file, by name.

    Raises:
        ConfigError: not a URDF file, one that is too large, what is not a tree of fixed, turning and sliding
            joints, a shape or number that cannot be.
    """
    robot = _parsed(file, arguments or {})
    links = [link.name for link in robot.links]
    joints = [_joint(each, file) for each in robot.joints]
    for what, names in (("link", links), ("joint", [each.name for each in joints])):
        if odd := [name for name in names if not (name and str(name).isprintable())]:
            problem = f"has the name {str(odd[0])[:60]!r}; give it one of printable characters on one line"
            raise ConfigError(file, what, problem)
        if twice := {name for name in names if names.count(name) > 1}:
            raise ConfigError(file, what, f"{min(twice)} is there twice; rename one")
    for each in joints:
        for link in (each.parent, each.child):
            if link not in links:
                raise ConfigError(
                    file, f"joint {each.name}", f"names the link {link!r}; {known_names(link, links)}"
                )
    children = [each.child for each in joints]
    roots = [link for link in links if link not in children]
    ordered = _ordered(joints, roots[0]) if len(roots) == 1 else []
    if len(ordered) != len(joints) or len(set(children)) != len(children):
        raise ConfigError(file, "", f"its links are no tree with one root; roots: {listing(roots)}")
    colours = {each.name: each.color.rgba for each in robot.materials if each.color is not None}
    shapes = {link.name: tuple(_shapes(link, colours, file)) for link in robot.links}
    return RigidRobot(str(robot.name), roots[0], shapes, tuple(ordered))


def _text(file: Path, arguments: Mapping[str, str]) -> bytes:
    """The URDF of a file."""
    if arguments and file.suffix != XACRO:
        raise ConfigError(file, "", f"takes no arguments ({listing(arguments)}); only xacro files do")
    try:
        if file.suffix == XACRO:
            text = expanded(file, arguments, MOST_BYTES)
        else:
            with file.open("rb") as stream:
                text = stream.read(MOST_BYTES + 1)
    except OSError as error:
        raise ConfigError(file, "", f"cannot be read ({error.strerror or error})") from error
    if len(text) > MOST_BYTES:
        raise ConfigError(file, "", f"is longer than {MOST_BYTES} bytes; make it shorter")
    return text


def _parsed(file: Path, arguments: Mapping[str, str]) -> Any:
    """The robot as the library reads it."""
    text = _text(file, arguments)
    try:
        urdf = importlib.import_module("urdf_parser_py.urdf").URDF
        core: Any = importlib.import_module("urdf_parser_py.xml_reflection.core")
    except ImportError as error:
        problem = f"reading URDF needs urdfdom_py: {install_command('arm')} (or apt install "
        raise ConfigError(file, "", f"{problem}ros-jazzy-urdfdom-py)") from error
    says, core.on_error = core.on_error, lambda message: None  # of tags of other programs
    try:
        robot = urdf.from_xml_string(text)
    except Exception as error:  # the parser's own kinds, and what odd files make of it
        reason = " ".join(str(error).split())[:160]
        raise ConfigError(file, "", f"is no URDF file ({type(error).__name__}: {reason})") from error
    finally:
        core.on_error = says
    if not robot.links or len(robot.joints) > MOST_JOINTS:
        raise ConfigError(file, "", f"must have links, and at most {MOST_JOINTS} joints")
    return robot


def _ordered(joints: list[UrdfJoint], root: str) -> list[UrdfJoint]:
    """Joints with parents before children, each chain in the order of the file."""
    result: list[UrdfJoint] = []
    ready = [each for each in joints if each.parent == root]
    while ready and len(result) <= len(joints):
        result.append(ready.pop(0))
        ready = [each for each in joints if each.parent == result[-1].child] + ready
    return result


def _joint(joint: Any, file: Path) -> UrdfJoint:
    where = f"joint {joint.name}"
    kinds = {"continuous": "revolute", "revolute": "revolute", "prismatic": "prismatic", "fixed": "fixed"}
    if joint.type not in kinds:
        raise ConfigError(file, where, f"is of type {joint.type}; allowed are {listing(kinds)}")
    kind, limits = kinds[joint.type], JointLimits()
    axis = np.array([1.0, 0.0, 0.0] if joint.axis is None else joint.axis, dtype=float)
    length = float(np.linalg.norm(axis))
    if kind != "fixed" and not 0.0 < length < math.inf:
        raise ConfigError(file, where, f"has the axis {axis.tolist()}, which is no direction")
    if joint.mimic is not None and kind != "fixed":
        warnings.warn(f"{file.name}: {where} follows {joint.mimic.joint}; it is taken as fixed", stacklevel=4)
        kind = "fixed"
    if kind != "fixed" and joint.limit is not None:
        limits = _limits(joint, file)
    return UrdfJoint(
        str(joint.name), kind, str(joint.parent), str(joint.child), _motion(joint.origin, file, where),
        axis / length if length > 0.0 else axis, limits,
    )  # fmt: skip


def _limits(joint: Any, file: Path) -> JointLimits:
    limit, where = joint.limit, f"joint {joint.name}"
    lower, upper = (
        (-math.inf, math.inf) if joint.type == "continuous" else (limit.lower or 0.0, limit.upper or 0.0)
    )
    speed = limit.velocity if limit.velocity else math.inf
    if not lower <= upper or not speed > 0.0:
        problem = f"has limits {lower} to {upper} at {speed}; they must be an interval and a speed > 0"
        raise ConfigError(file, where, problem)
    return JointLimits(lower, upper, speed)


def _motion(pose: Any, file: Path, where: str) -> Motion:
    """A pose of the file; None: the frame itself."""
    shift, angles = (np.zeros(3), np.zeros(3)) if pose is None else (_triple(pose.xyz), _triple(pose.rpy))
    if not np.isfinite([shift, angles]).all():
        raise ConfigError(file, where, "has a pose that is not finite")
    return Motion(rotation_euler(angles), shift)


def _triple(values: Any) -> Array:
    """Three numbers of the file; None: zeros."""
    return np.zeros(3) if values is None else np.array(values, dtype=float)


def _shapes(link: Any, colours: dict[str, Any], file: Path) -> Iterator[LinkShape]:
    """The collision shapes of a link, or where it has none, what one sees of it."""
    colour = GREY
    for visual in link.visuals:
        material = visual.material
        if material is not None:
            rgba = material.color.rgba if material.color is not None else colours.get(material.name)
            colour = GREY if rgba is None else tuple(float(min(max(each, 0.0), 1.0)) for each in rgba)  # type: ignore[assignment]
            break
    touches = bool(link.collisions)
    for each in link.collisions if touches else link.visuals:
        where = f"link {link.name}"
        shape = _shape(each.geometry, file, where)
        if shape is not None:
            yield LinkShape(shape, _motion(each.origin, file, where), colour, touches)


def _shape(geometry: Any, file: Path, where: str) -> Shape | None:
    """A shape; None: a mesh of a type that is not read."""
    try:
        if hasattr(geometry, "size"):
            x, y, z = (float(each) for each in geometry.size)
            return Shape(box=(x, y, z))
        if hasattr(geometry, "length"):
            return Shape(cylinder=(float(geometry.radius), float(geometry.length)))
        if hasattr(geometry, "radius"):
            return Shape(sphere=float(geometry.radius))
    except SceneError as error:
        raise ConfigError(file, where, str(error)) from error
    if not hasattr(geometry, "filename"):
        raise ConfigError(file, where, "has a shape without box, cylinder, sphere or mesh")
    name = str(geometry.filename)
    scale = np.ones(3) if geometry.scale is None else np.array(geometry.scale, dtype=float)
    if not 0.0 < scale[0] < math.inf or np.ptp(scale) > 1e-9 * scale[0]:
        raise ConfigError(file, where, f"scales {name} by {scale.tolist()}; give one factor > 0 for all axes")
    if Path(name).suffix.lower() not in MESHES:
        warnings.warn(f"{file.name}: {where} without {name}; {listing(MESHES)} are read", stacklevel=6)
        return None
    found = _mesh_file(name, file, where)
    return Shape(mesh=MeshFile(file=found, placement=Placement(scale=float(scale[0]))))


def _mesh_file(name: str, file: Path, where: str) -> Path:
    """A mesh that a URDF names: relative to it, absolute, or package://PACKAGE/PATH."""
    path, package = name.removeprefix("file://"), ""
    folders: Iterable[Path] = [file.parent]
    if name.startswith("package://"):
        package, _, path = name.removeprefix("package://").partition("/")
        folders = package_folders(package, file)
    looked_at = []
    for folder in folders:
        if (folder / path).is_file():
            return (folder / path).resolve()
        looked_at.append(folder)
    why = f"which is not in {listing(looked_at)}" if looked_at else not_found(package, file)
    raise ConfigError(file, where, f"names the mesh {name}, {why}")
