"""Imports run one way: softsim_ros -> softsim_core; servo_bridge -> a few modules of softsim_core."""

from __future__ import annotations

import ast
import dataclasses
import functools
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from faces import face, home, packages
from source_trees import tree_of

from softsim_core.scene import RobotDescription

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGES = ("softsim_core", "softsim_node", "softsim_ros", "servo_bridge", "benchmarks")

ROS = (
    "rclpy",
    "ament_index_python",
    "builtin_interfaces",
    "diagnostic_msgs",
    "geometry_msgs",
    "launch",
    "launch_ros",
    "lifecycle_msgs",
    "nav_msgs",
    "rcl_interfaces",
    "rosgraph_msgs",
    "sensor_msgs",
    "shape_msgs",
    "std_msgs",
    "std_srvs",
    "tf2_msgs",
    "tf2_ros",
    "trajectory_msgs",
    "visualization_msgs",
)

FORBIDDEN = {
    "softsim_core": ("softsim_node", "softsim_ros", "servo_bridge", "benchmarks", "serial", "rich", *ROS),
    "softsim_node": ("softsim_ros", "servo_bridge", "benchmarks"),
    "servo_bridge": ("softsim_ros", "benchmarks"),
    "softsim_ros": ("benchmarks",),
    "benchmarks": (),
}
"""What a package may not import."""

BRIDGE_MAY_USE = (
    "softsim_core.base.errors",
    "softsim_core.base.files",
    "softsim_core.base.moved",
    "softsim_core.base.names",
    "softsim_core.base.units",
    "softsim_core.physics.mechanics.limits",
    "softsim_core.scene",
    "softsim_core.scene.board",
    "softsim_core.scene.description",
    "softsim_core.scene.io.files",
    "softsim_core.scene.io.loaders",
    "softsim_core.scene.io.structure",
    "softsim_core.scene.io.yaml_source",
    "softsim_core.scene.robot",
)
"""What servo_bridge uses of the core: errors, names, units, limits, commands, robots and their loader."""

LAYERS = (
    ("base",),
    ("physics.kernels",),
    ("physics.linalg",),
    ("physics.mesh",),
    ("physics.fem",),
    ("physics.mechanics",),
    ("physics.actuation",),
    ("physics.contact",),
    ("physics.dynamics",),
    ("physics.sensing",),
    ("scene",),
    ("robots", "mjcf"),
    ("simulation",),
    ("control.inverse",),
    ("control.observer",),
    ("lab.meshing", "lab.identification"),
    ("lab.learning",),
    ("lab.study",),
)
"""Packages of softsim_core, lowest first; the last ones run whole simulations."""


INTERFACES = ("cli", "keys", "nodes.teleop", "nodes.viewer", "recording")
"""What drives a robot or looks at it, for a person."""

NODES_KNOW = {
    "client": (*INTERFACES, "nodes.simulator", "nodes.inverse"),
    "keys": ("cli", "nodes.teleop", "nodes.viewer", "nodes.simulator", "nodes.inverse"),
    "nodes.teleop": ("cli", "nodes.viewer", "nodes.simulator", "nodes.inverse"),
    "nodes.viewer": ("cli", "nodes.teleop", "nodes.simulator", "nodes.inverse"),
    "nodes.inverse": INTERFACES,
}
"""Folders of softsim_ros that a folder of softsim_ros may not import."""


PHYSICS = (
    *(f"physics/{name}" for name in ("linalg", "mesh", "fem", "mechanics", "actuation", "contact")),
    *(f"physics/{name}" for name in ("dynamics", "sensing")),
    "scene/description.py",
    "scene/deformable.py",
    "scene/building/bodies.py",
    "scene/building/*builder.py",
    "simulation/scene_state.py",
)
"""What knows bodies, joints and forces, and nothing of the robot around them."""

ROBOT_MODULES = tuple(f"softsim_core.scene.{name}" for name in ("robot", "control", "board", "view", "scene"))
ROBOT_WORDS = {"board", "keyboard", "namespace", "ros", "teleop", "viewer"}
"""Words that name nothing but a robot's matters."""

ROBOT_FIELDS = {field.name for field in dataclasses.fields(RobotDescription)} - {"scene"}
"""What a robot has beside its scene; `scene.keys` is one, the keys of a mapping or of a sort are not."""


def imports(tree: ast.AST, package: str) -> Iterator[tuple[str, int]]:
    """Absolute names of imported modules, with lines.

    `from a import b` gives a.b where b is a module, or the module of b where the face of a has it.
    """
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parents = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            module = ".".join([*parents, *([node.module] if node.module else [])])
            for alias in node.names:
                below = REPOSITORY.joinpath(*module.split("."), alias.name)
                is_module = below.is_dir() or below.with_suffix(".py").is_file()
                if module in packages() and alias.name in face(module):
                    yield home(module, alias.name), node.lineno
                else:
                    yield (f"{module}.{alias.name}" if is_module else module), node.lineno
        else:
            yield from imports(node, package)


def sources(package: str) -> list[Path]:
    return sorted((REPOSITORY / package).rglob("*.py"))


@functools.cache
def imported(file: Path) -> list[tuple[str, int]]:
    package = ".".join(file.relative_to(REPOSITORY).parent.parts)
    return list(imports(tree_of(file), package))


def within(name: str, modules: tuple[str, ...]) -> bool:
    return any(name == module or name.startswith(f"{module}.") for module in modules)


@pytest.mark.parametrize("package", PACKAGES)
def test_no_forbidden_import(package: str) -> None:
    assert sources(package)
    found = [
        f"{file.relative_to(REPOSITORY)}:{line} imports {name}"
        for file in sources(package)
        for name, line in imported(file)
        if within(name, FORBIDDEN[package])
    ]
    assert found == []


def layer(name: str) -> tuple[int, str]:
    """Rank and name of the package of softsim_core that a module belongs to; -1 for softsim_core itself."""
    for rank, group in enumerate(LAYERS):
        for package in group:
            if within(name, (f"softsim_core.{package}",)):
                return rank, package
    return -1, ""


def test_packages_of_the_core_import_downward_only() -> None:
    found = []
    for file in sources("softsim_core"):
        own, package = layer(".".join(file.relative_to(REPOSITORY).with_suffix("").parts))
        if not package:
            continue  # the face of softsim_core names what is above it, and loads it when it is asked for
        for name, line in imported(file):
            other, below = layer(name)
            if below and below != package and other >= own:
                found.append(f"{file.relative_to(REPOSITORY)}:{line} imports {name}")
    assert found == []


def test_every_package_of_the_core_has_its_layer() -> None:
    folders = {file.parent.relative_to(REPOSITORY) for file in sources("softsim_core")}
    packages = {".".join(folder.parts) for folder in folders if len(folder.parts) > 1}
    groups = {"softsim_core.physics", "softsim_core.control", "softsim_core.lab"}
    assert [name for name in sorted(packages - groups) if not layer(name)[1]] == []


def test_user_interfaces_meet_in_the_client_only() -> None:
    found = [
        f"{file.relative_to(REPOSITORY)}:{line} imports {name}"
        for folder, others in NODES_KNOW.items()
        for file in sources(f"softsim_ros/{folder.replace('.', '/')}")
        for name, line in imported(file)
        if within(name, tuple(f"softsim_ros.{other}" for other in others))
    ]
    assert found == []


def physics() -> list[Path]:
    core = REPOSITORY / "softsim_core"
    patterns = [name if name.endswith(".py") else f"{name}/**/*.py" for name in PHYSICS]
    found = {pattern: set(core.glob(pattern)) for pattern in patterns}
    assert all(found.values()), found
    return sorted(set().union(*found.values()))


def robot_words(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """Words of a robot in names and texts, and fields of a robot that are read from a scene."""
    for node in ast.walk(tree):
        for field in ("id", "attr", "arg", "name", "value"):
            text = getattr(node, field, None)
            if isinstance(text, str):
                words = re.findall(r"[A-Z]?[a-z]+|[A-Z]+", text)
                yield from ((word, node.lineno) for word in words if word.lower() in ROBOT_WORDS)
        if isinstance(node, ast.Attribute) and node.attr in ROBOT_FIELDS:
            owner = ast.unparse(node.value).rpartition(".")[2]
            if owner in ("scene", "description", "robot"):
                yield f"{owner}.{node.attr}", node.lineno


def test_the_physics_imports_no_robot_matters() -> None:
    found = [
        f"{file.relative_to(REPOSITORY)}:{line} imports {name}"
        for file in physics()
        for name, line in imported(file)
        if within(name, ROBOT_MODULES)
    ]
    assert found == []


def test_the_physics_does_not_mention_keys_boards_poses_views_or_ros() -> None:
    found = [
        f"{file.relative_to(REPOSITORY)}:{line} says {word}"
        for file in physics()
        for word, line in robot_words(tree_of(file))
    ]
    assert found == []


def test_the_reader_of_words_sees_every_form() -> None:
    code = """
def press(board_file, keys): "A text about ROS."
simulation.scene.view = NamespaceOf(scene.poses, pose=3, boarding=array.view(), order=values.keys())
class BoardUser: pass
"""
    words = sorted(word for word, _ in robot_words(ast.parse(code)))
    assert words == ["Board", "Namespace", "ROS", "board", "scene.poses", "scene.view"]


def test_functions_of_the_core_take_at_most_eight_arguments() -> None:
    """But for compiled kernels, which take named groups of arrays beside numbers."""
    found = []
    for file in sources("softsim_core"):
        for node in ast.walk(tree_of(file)):
            if isinstance(node, ast.FunctionDef):
                marks = {ast.unparse(mark) for mark in node.decorator_list}
                names = [
                    each.arg for each in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
                ]
                count = len(names) - (names[:1] == ["self"] or names[:1] == ["cls"])
                if count > 8 and not marks & {"kernel", "part", "inline", "intrinsic"}:
                    found.append(f"{file.relative_to(REPOSITORY)}:{node.lineno} {node.name} takes {count}")
    assert found == []


def test_no_files_of_the_packages_import_each_other_in_a_circle() -> None:
    modules = {
        ".".join(file.relative_to(REPOSITORY).with_suffix("").parts).removesuffix(".__init__"): file
        for package in PACKAGES
        for file in sources(package)
    }
    arrows = {
        name: {
            other
            for other, _ in imported(file)
            if other in modules and not f"{name}.".startswith(f"{other}.")
        }
        for name, file in modules.items()
    }
    while leaves := {name for name, below in arrows.items() if not below & arrows.keys()}:
        arrows = {name: below for name, below in arrows.items() if name not in leaves}
    assert sorted(arrows) == []


def test_the_bridge_uses_only_errors_units_limits_and_robot_configs() -> None:
    found = [
        f"{file.relative_to(REPOSITORY)}:{line} imports {name}"
        for file in sources("servo_bridge")
        for name, line in imported(file)
        if within(name, ("softsim_core",))
        and name not in BRIDGE_MAY_USE
        and (name, file.name) != ("softsim_core", "__init__.py")  # which loads nothing
    ]
    assert found == []


@pytest.mark.ros
def test_programs_that_only_read_scenes_start_without_the_compiler() -> None:
    """Numba takes a quarter of the time in which they would start."""
    for name in ("rclpy", "viser", "mcap"):
        pytest.importorskip(name)
    nodes = (
        "softsim_ros.nodes.teleop.teleop_node",
        "softsim_ros.nodes.viewer.viewer_node",
        "softsim_ros.recording.recorder_node",
        "servo_bridge.nodes.bridge_node",
    )
    code = f"import sys, {', '.join(nodes)}; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, check=False).returncode == 0


def library_part(file: Path) -> Iterator[ast.AST]:
    """Everything in a module but the blocks that run when it is a program (`if __name__ == "__main__"`)."""
    for node in tree_of(file).body:
        if not (isinstance(node, ast.If) and ast.unparse(node.test).startswith("__name__ ==")):
            yield from ast.walk(node)


def test_the_core_prints_nothing() -> None:
    found = [
        f"{file.relative_to(REPOSITORY)}:{node.lineno}"
        for file in sources("softsim_core")
        for node in library_part(file)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print"
    ]
    assert found == []


def test_the_reader_of_imports_sees_every_form() -> None:
    code = """
import a.b as c, d
from e.f import g
def function():
    import h
try:
    from . import i
except ImportError:
    from .. import j
from softsim_core import Simulation_of_no_module, scene
from softsim_core.base import MeshError
if TYPE_CHECKING:
    import k
else:
    import l
"""
    names = [name for name, _ in imports(ast.parse(code), "p.q")]
    assert names == [
        "a.b",
        "d",
        "e.f",
        "h",
        "p.q",
        "p",
        "softsim_core",
        "softsim_core.scene",
        "softsim_core.base.errors",
        "k",
        "l",
    ]


def test_the_core_loads_scenes_without_the_optional_packages() -> None:
    """Describing a scene in Python needs neither PyYAML nor Numba, ROS or a serial port."""
    code = (
        "import sys\n"
        "for name in ('yaml', 'numba', 'rclpy', 'serial', 'meshio'): sys.modules[name] = None\n"
        "from softsim_core.scene import Scene, load_scene\n"
        "from softsim_core.robots import servo\n"
        "scene = Scene(); scene.add(servo('a')); assert scene.describe().joint_names == ('a',)\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, timeout=60, check=False
    )
    assert result.stderr == ""
    assert result.returncode == 0
