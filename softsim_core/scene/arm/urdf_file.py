"""Rigid robots in URDF and Xacro files: links, shapes, joints, and ROS packages.

Source: the URDF specification of ROS (wiki.ros.org/urdf/XML); parsed by ROS 2's own urdfdom_py.
"""

from __future__ import annotations

import importlib
import math
import os
import stat
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

import numpy as np

from softsim_core.base import (
    Array,
    ConfigError,
    MeshFile,
    Placement,
    SceneError,
    install_command,
    known_names,
    listing,
)
from softsim_core.physics.mechanics import JointLimits, rotation_euler
from softsim_core.physics.mesh import Shape
from softsim_core.scene import Motion
from softsim_core.scene.io import XACRO, allowed_program, may_hold_programs

MANIFEST: Final = "package.xml"
MOST_MANIFEST_BYTES: Final = 1_000_000
MOST_ABOVE: Final = 6
"""Number of searched folders above a file: all five of WORKSPACE/src/REPOSITORY/PACKAGE/urdf."""
MOST_BELOW: Final = 3
"""Depth to which the children of a folder are searched."""
MOST_FOLDERS: Final = 5000
"""Folders that one search visits at most."""
AMENT, CATKIN = "AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH"
_IGNORED: Final = ("COLCON_IGNORE", "AMENT_IGNORE", "CATKIN_IGNORE")


def package_folders(
    package: str, file: Path, allowed: Callable[[Path], bool] = lambda folder: True
) -> Iterator[Path]:
    """Search a ROS package above a file, beside the folders above it, and in the environment's paths.

    A folder is the package if its `package.xml` has the name; above the file and below AMENT_PREFIX_PATH also
    if the folder has the name. Children of / and of the home folder are not searched, nor those of a folder
    that other users may write, such as /tmp.

    Yields:
        Folders that exist, the nearest first; those beside the ones above the file only if `allowed`.
    """
    above = file.resolve().parents
    yield from (folder for folder in above if folder.name == package or _name_of(folder) == package)
    yield from (folder for folder in _below(package, _list_search_folders(file)) if allowed(folder))
    shares = (entry / "share" / package for entry in _entries(AMENT))
    yield from (folder for folder in shares if folder.is_dir())
    yield from _below(package, _entries(CATKIN))


def not_found(package: str, file: Path) -> str:
    """Return the message that a package is in none of `package_folders`, with the places searched."""
    below = listing(f"{folder}" for folder in _list_search_folders(file)[-1:])
    entries = (f"{name} ({listing(_entries(name))})" for name in (AMENT, CATKIN))
    return (
        f"package {package} is in no folder of that name and no folder with its package.xml above {file}, "
        f"up to {MOST_BELOW} folders below {below}, and in {listing(entries)}; put it beside the file's own "
        f"package, or name its folder in {CATKIN}"
    )


def _entries(variable: str) -> list[Path]:
    return [Path(entry) for entry in os.environ.get(variable, "").split(os.pathsep) if entry]


def _list_search_folders(file: Path) -> list[Path]:
    """Return the folders above a file whose children are searched."""
    above = file.resolve().parents[:MOST_ABOVE]
    return [each for each in above if each not in (Path(each.anchor), Path.home()) and _is_trusted(each)]


def _is_trusted(folder: Path) -> bool:
    """Return whether only this user and root may write into a folder."""
    status = folder.stat()
    own = not hasattr(os, "getuid") or status.st_uid in (0, os.getuid())
    return own and not status.st_mode & stat.S_IWOTH


def _below(package: str, roots: Iterable[Path]) -> Iterator[Path]:
    """Yield the folders of a package among some folders and below them."""
    visited: set[Path] = set()
    for root in roots:
        for folder in _packages(root, MOST_BELOW, visited):
            if _name_of(folder) == package:
                yield folder


def _packages(folder: Path, depth: int, visited: set[Path]) -> Iterator[Path]:
    """Yield the folder if it has a manifest, else those below it that have one. Packages are not nested."""
    if folder in visited or len(visited) >= MOST_FOLDERS:
        return
    visited.add(folder)
    if (folder / MANIFEST).is_file():
        yield folder
    elif depth > 0 and not any((folder / name).exists() for name in _IGNORED):
        children: list[Path] = []  # trusted folders, without hidden ones and links; none if unreadable
        with suppress(OSError):
            with os.scandir(folder) as entries:
                names = [each.name for each in entries if each.is_dir(follow_symlinks=False)]
            shown = (folder / name for name in sorted(names) if not name.startswith("."))
            children = [child for child in shown if _is_trusted(child)]
        for child in children:
            yield from _packages(child, depth - 1, visited)


def _name_of(folder: Path) -> str:
    """Return the name in the manifest of a folder, or "" without a readable manifest."""
    try:
        with (folder / MANIFEST).open("rb") as stream:
            text = stream.read(MOST_MANIFEST_BYTES + 1)
        if len(text) > MOST_MANIFEST_BYTES:
            return ""
        return (ElementTree.fromstring(text).findtext("name") or "").strip()
    except (OSError, ElementTree.ParseError, ValueError, LookupError):
        return ""


def expand_xacro(file: Path, arguments: Mapping[str, str]) -> bytes:
    """Expand a xacro file to URDF.

    Xacro evaluates `${...}` as Python: such a file is a program, and runs only where `scene.programs` allows
    it. `$(find PACKAGE)` is the first of its `package_folders`. Folders beside those above the file are
    searched only where programs may run, because xacro runs the files that it includes.

    `arguments` are values of its arguments (`xacro:arg`), by name.

    Raises:
        ConfigError: it may not run, xacro is not installed, or the file is too long or cannot be expanded.
        OSError: there is no such file.
    """
    program = allowed_program(file)
    if program.stat().st_size > MOST_BYTES:
        raise ConfigError(file, "", f"is longer than {MOST_BYTES} bytes; make it shorter")
    try:
        xacro: Any = importlib.import_module("xacro")
        substitution: Any = importlib.import_module("xacro.substitution_args")
    except ImportError as error:
        problem = f"is a xacro file, which xacro expands: {install_command('arm')} (or apt install "
        raise ConfigError(file, "", f"{problem}ros-jazzy-xacro)") from error
    with _finding(substitution, file):
        try:
            document = xacro.process_file(str(program), mappings=dict(arguments), verbosity=0)
            return bytes(document.toprettyxml(indent=" ", encoding="utf-8"))
        except Exception as error:  # the library's errors, and any error of an expression
            reason = " ".join(f"{type(error).__name__}: {error}".split())[:1000]
            raise ConfigError(file, "", f"xacro cannot expand it ({reason})") from error


@contextmanager
def _finding(substitution: Any, file: Path) -> Iterator[None]:
    """Let xacro find packages in the same folders as the meshes of a URDF file, within the `with` block."""

    def find(package: str) -> str:
        folder = next(package_folders(package, file, may_hold_programs), None)
        if folder is None:
            raise LookupError(not_found(package, file))
        return str(folder)

    before = substitution._eval_find
    substitution._eval_find = find
    try:
        yield
    finally:
        substitution._eval_find = before


MOST_BYTES: Final = 10_000_000
"""A larger file is refused before it is parsed."""
MOST_JOINTS: Final = 1000
MESHES: Final = (".stl", ".obj", ".ply")
"""File types of supported meshes."""
GREY: Final = (0.6, 0.62, 0.65, 1.0)
"""Default colour of shapes."""


@dataclass(frozen=True, slots=True, eq=False)
class LinkShape:
    """A shape of a link: its pose in the link's frame, red, green, blue, alpha; whether it touches."""

    shape: Shape
    pose: Motion
    colour: tuple[float, float, float, float]
    touches: bool


@dataclass(frozen=True, slots=True, eq=False)
class UrdfJoint:
    """A joint; at position 0 its frame in the parent link is the frame of the child link.

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
    """A tree of links: `root` is the one without parent; joints are ordered with parents before children."""

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
    """Read a rigid robot from a URDF file, or from a xacro file, which is expanded.

    Joints that follow others (`mimic`) stay at 0, and meshes of types not in MESHES are left out, each with a
    warning. `arguments` are those of a xacro file, by name.

    Raises:
        ConfigError: not a URDF file, a file that is too large, not a tree of fixed, revolute and prismatic
            joints, or an invalid shape or number.
    """
    robot = _parse_robot(file, arguments or {})
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
                problem = f"names the link {link!r}; {known_names(link, links)}"
                raise ConfigError(file, f"joint {each.name}", problem)
    children = [each.child for each in joints]
    roots = [link for link in links if link not in children]
    ordered = _order_joints(joints, roots[0]) if len(roots) == 1 else []
    if len(ordered) != len(joints) or len(set(children)) != len(children):
        raise ConfigError(file, "", f"its links are no tree with one root; roots: {listing(roots)}")
    colours = {each.name: each.color.rgba for each in robot.materials if each.color is not None}
    shapes = {link.name: tuple(_shapes(link, colours, file)) for link in robot.links}
    return RigidRobot(str(robot.name), roots[0], shapes, tuple(ordered))


def _parse_robot(file: Path, arguments: Mapping[str, str]) -> Any:
    """Parse the robot of a URDF file, or of an expanded xacro file, with the library."""
    if arguments and file.suffix != XACRO:
        raise ConfigError(file, "", f"takes no arguments ({listing(arguments)}); only xacro files do")
    try:
        if file.suffix == XACRO:
            text = expand_xacro(file, arguments)
        else:
            with file.open("rb") as stream:
                text = stream.read(MOST_BYTES + 1)
    except OSError as error:
        raise ConfigError(file, "", f"cannot be read ({error.strerror or error})") from error
    if len(text) > MOST_BYTES:
        raise ConfigError(file, "", f"is longer than {MOST_BYTES} bytes; make it shorter")
    try:
        urdf = importlib.import_module("urdf_parser_py.urdf").URDF
        core: Any = importlib.import_module("urdf_parser_py.xml_reflection.core")
    except ImportError as error:
        problem = f"reading URDF needs urdfdom_py: {install_command('arm')} (or apt install "
        raise ConfigError(file, "", f"{problem}ros-jazzy-urdfdom-py)") from error
    says, core.on_error = core.on_error, lambda message: None  # silence messages on tags of other programs
    try:
        robot = urdf.from_xml_string(text)
    except Exception as error:  # the parser's errors, and any error that invalid files cause
        reason = " ".join(str(error).split())[:160]
        raise ConfigError(file, "", f"is no URDF file ({type(error).__name__}: {reason})") from error
    finally:
        core.on_error = says
    if not robot.links or len(robot.joints) > MOST_JOINTS:
        raise ConfigError(file, "", f"must have links, and at most {MOST_JOINTS} joints")
    return robot


def _order_joints(joints: list[UrdfJoint], root: str) -> list[UrdfJoint]:
    """Order joints with parents before children, each chain in the order of the file."""
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
    if kind != "fixed" and (limit := joint.limit) is not None:
        lower, upper = (limit.lower or 0.0), (limit.upper or 0.0)
        if joint.type == "continuous":
            lower, upper = -math.inf, math.inf
        speed = limit.velocity or math.inf
        if not lower <= upper or not speed > 0.0:
            problem = f"has limits {lower} to {upper} at {speed}; they must be an interval and a speed > 0"
            raise ConfigError(file, where, problem)
        limits = JointLimits(lower, upper, speed)
    return UrdfJoint(
        str(joint.name), kind, str(joint.parent), str(joint.child), _motion(joint.origin, file, where),
        axis / length if length > 0.0 else axis, limits,
    )  # fmt: skip


def _motion(pose: Any, file: Path, where: str) -> Motion:
    """Convert a pose of the file; None: identity."""
    shift, angles = (np.zeros(3), np.zeros(3)) if pose is None else (_triple(pose.xyz), _triple(pose.rpy))
    if not np.isfinite([shift, angles]).all():
        raise ConfigError(file, where, "has a pose that is not finite")
    return Motion(rotation_euler(angles), shift)


def _triple(values: Any) -> Array:
    """Convert three numbers of the file; None: zeros."""
    return np.zeros(3) if values is None else np.array(values, dtype=float)


def _shapes(link: Any, colours: dict[str, Any], file: Path) -> Iterator[LinkShape]:
    """Yield the collision shapes of a link, or its visual shapes if it has none."""
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
    """Convert a shape; None: a mesh of an unsupported type."""
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
    """Return the mesh file that a URDF names: relative to it, absolute, or package://PACKAGE/PATH."""
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
