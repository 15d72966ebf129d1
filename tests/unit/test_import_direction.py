"""Imports run one way: softsim_ros -> softsim_core; servo_bridge -> a few modules of softsim_core."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGES = ("softsim_core", "softsim_ros", "servo_bridge")

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
    "softsim_core": ("softsim_ros", "servo_bridge", "serial", "rich", *ROS),
    "servo_bridge": ("softsim_ros",),
    "softsim_ros": (),
}
"""What a package may not import."""

BRIDGE_MAY_USE = (
    "softsim_core.errors",
    "softsim_core.units",
    "softsim_core.actuation.limits",
    "softsim_core.scene",
    "softsim_core.scene.description",
    "softsim_core.scene.files",
    "softsim_core.scene.yaml_source",
)
"""What servo_bridge uses of the core: errors, units, limits, and the description and loader of robots."""


def imports(tree: ast.AST, package: str) -> Iterator[tuple[str, int]]:
    """Absolute names of imported modules, with lines; `from a import b` gives a.b where b is a module."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parents = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            module = ".".join([*parents, *([node.module] if node.module else [])])
            for alias in node.names:
                below = REPOSITORY.joinpath(*module.split("."), alias.name)
                is_module = below.is_dir() or below.with_suffix(".py").is_file()
                yield (f"{module}.{alias.name}" if is_module else module), node.lineno
        else:
            yield from imports(node, package)


def sources(package: str) -> list[Path]:
    return sorted((REPOSITORY / package).rglob("*.py"))


def imported(file: Path) -> list[tuple[str, int]]:
    package = ".".join(file.relative_to(REPOSITORY).parent.parts)
    return list(imports(ast.parse(file.read_text()), package))


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


def test_the_bridge_uses_only_errors_units_limits_and_robot_configs() -> None:
    found = [
        f"{file.relative_to(REPOSITORY)}:{line} imports {name}"
        for file in sources("servo_bridge")
        for name, line in imported(file)
        if within(name, ("softsim_core",)) and name not in BRIDGE_MAY_USE
    ]
    assert found == []


def library_part(file: Path) -> Iterator[ast.AST]:
    """Everything in a module but the blocks that run when it is a program (`if __name__ == "__main__"`)."""
    for node in ast.parse(file.read_text()).body:
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
from softsim_core import Simulation_of_no_module, mesh
from softsim_core.errors import MeshError
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
        "softsim_core.mesh",
        "softsim_core.errors",
        "k",
        "l",
    ]


def test_the_core_loads_scenes_without_the_optional_packages() -> None:
    """Describing a scene in Python needs neither cattrs nor PyYAML nor Numba, ROS or a serial port."""
    code = (
        "import sys\n"
        "for name in ('cattrs', 'yaml', 'numba', 'rclpy', 'serial', 'meshio'): sys.modules[name] = None\n"
        "from softsim_core.scene import Scene, load_scene\n"
        "from softsim_core.scene.parts import servo\n"
        "scene = Scene(); scene.add(servo('a')); assert scene.describe().joint_names == ('a',)\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, timeout=60, check=False
    )
    assert result.stderr == ""
    assert result.returncode == 0
