"""What the project declares fits what it uses: pins, ROS dependencies, versions, the launch file."""

from __future__ import annotations

import ast
import re
import sys
import types
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any, ClassVar

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
WORKSPACE = REPOSITORY / "ros2_ws" / "src"
PACKAGES = ("softsim_core", "softsim_node", "softsim_ros", "servo_bridge")
ROSDEP = {
    "numpy": "python3-numpy", "scipy": "python3-scipy", "numba": "python3-numba", "meshio": "python3-meshio",
    "yaml": "python3-yaml", "serial": "python3-serial",
}  # fmt: skip
WITHOUT_KEY = {"cattrs"}  # rosdep has no key for it; the package.xml says what to install


def imports(package: str) -> set[str]:
    """Top-level names that the modules of a package import, anywhere in them."""
    names: set[str] = set()
    for file in (REPOSITORY / package).rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                names |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                names.add(node.module.split(".")[0])
    return names - set(sys.stdlib_module_names)


def requirements(text: str) -> list[str]:
    """Names of the distributions in a list of requirements of pyproject.toml."""
    return re.findall(r'^\s+"([A-Za-z0-9_-]+)', text, re.MULTILINE)


def test_every_requirement_is_pinned() -> None:
    project = (REPOSITORY / "pyproject.toml").read_text()
    declared = project.split("dependencies = [")[1].split("]\n")[0] + "\n"
    declared += project.split("[project.optional-dependencies]")[1].split("\n[")[0]
    pinned = {
        line.split("==")[0].lower().replace("_", "-")
        for line in (REPOSITORY / "constraints.txt").read_text().splitlines()
        if "==" in line and not line.startswith("#")
    }
    names = requirements(declared)
    assert {"numpy", "ros-jazzy-rclpy", "pytest"} <= set(names)
    assert [name for name in names if name.lower() not in pinned] == []


@pytest.mark.parametrize("name", ["pyproject.toml", "constraints.txt", "softsim", ".ci/run"])
def test_no_package_registry_is_named(name: str) -> None:
    assert not re.search(r"https?://|index-url", (REPOSITORY / name).read_text())


@pytest.mark.parametrize("package", [*PACKAGES, "softsim_bringup"])
def test_ros_packages_carry_the_project_s_version_and_licence(package: str) -> None:
    project = (REPOSITORY / "pyproject.toml").read_text()
    version = re.search(r'^version = "(.*)"', project, re.MULTILINE)
    assert version
    root = ElementTree.parse(WORKSPACE / package / "package.xml").getroot()
    assert (root.get("format"), root.findtext("name")) == ("3", package)
    assert root.findtext("version") == version[1]
    assert root.findtext("license") == "Apache-2.0"
    assert f'version="{version[1]}"' in (WORKSPACE / package / "setup.py").read_text()
    assert (WORKSPACE / package / "resource" / package).is_file()


@pytest.mark.parametrize("package", PACKAGES)
def test_the_workspace_links_to_the_packages(package: str) -> None:
    link = WORKSPACE / package / package
    assert link.is_symlink()
    assert not link.readlink().is_absolute()
    assert link.resolve() == REPOSITORY / package


@pytest.mark.slow
@pytest.mark.parametrize("package", PACKAGES)
def test_package_xml_names_what_the_code_imports(package: str) -> None:
    root = ElementTree.parse(WORKSPACE / package / "package.xml").getroot()
    declared = {element.text for element in root.iter("exec_depend")}
    used = imports(package) - {package} - WITHOUT_KEY
    # optional imports, behind a test whether they are there
    used -= {"daqp", "matplotlib", "pydrake", "mujoco", "ament_index_python", "llvmlite", "rosbags", "viser"}
    used -= {"websockets", "imageio", "msgspec", "lz4"}  # viser's own, and rosbags'
    assert {ROSDEP.get(name, name) for name in used} - declared == set()


# `launch` is not on PyPI: these stand in for it with the keywords its documentation gives, and only record.

DOCUMENTED = {
    "launch": {"LaunchDescription": {"initial_entities"}},
    "launch.actions": {
        "DeclareLaunchArgument": {"name", "default_value", "description", "choices", "condition"},
        "LogInfo": {"msg", "condition"},
        "Shutdown": {"reason", "condition"},
    },
    "launch.conditions": {"IfCondition": {"predicate_expression"}},
    "launch.substitutions": {
        "EnvironmentVariable": {"name", "default_value"},
        "EqualsSubstitution": {"left", "right"},
        "IfElseSubstitution": {"condition", "if_value", "else_value"},
        "LaunchConfiguration": {"variable_name", "default"},
        "PathJoinSubstitution": {"substitutions"},
    },
    "launch_ros": {},
    "launch_ros.actions": {
        "Node": {
            "executable", "package", "name", "namespace", "exec_name", "parameters", "remappings",
            "arguments", "ros_arguments", "output", "condition", "on_exit", "respawn", "emulate_tty",
        }
    },
    "launch_ros.parameter_descriptions": {"ParameterValue": {"value", "value_type"}},
    "launch_ros.substitutions": {"FindPackageShare": {"package"}},
}  # fmt: skip


class Recorded:
    allowed: ClassVar[set[str]] = set()

    def __init__(self, *positional: Any, **keywords: Any) -> None:
        unknown = set(keywords) - self.allowed
        assert not unknown, f"{type(self).__name__} has no {unknown}"
        self.positional, self.keywords = positional, keywords


@pytest.fixture
def described(monkeypatch: pytest.MonkeyPatch) -> list[Recorded]:
    """The entities of tripod.launch.py, as recorded by the stand-ins."""
    for module_name, classes in DOCUMENTED.items():
        module = types.ModuleType(module_name)
        for name, allowed in classes.items():
            setattr(module, name, type(name, (Recorded,), {"allowed": allowed}))
        monkeypatch.setitem(sys.modules, module_name, module)
    file = WORKSPACE / "softsim_bringup" / "launch" / "tripod.launch.py"
    space: dict[str, Any] = {}
    exec(compile(file.read_text(), str(file), "exec"), space)
    entities: list[Recorded] = space["generate_launch_description"]().positional[0]
    return entities


def test_the_launch_file_starts_what_is_installed(described: list[Recorded]) -> None:
    arguments = {
        entity.positional[0] for entity in described if type(entity).__name__ == "DeclareLaunchArgument"
    }
    assert arguments == {"robot", "namespace", "port", "source", "autostart", "inverse", "rviz"}
    nodes = [entity.keywords for entity in described if type(entity).__name__ == "Node"]
    started = {(node["package"], node["executable"]) for node in nodes}
    ours = started - {("rviz2", "rviz2")}
    assert ours == {
        ("softsim_ros", "simulator"),
        ("softsim_ros", "inverse_controller"),
        ("servo_bridge", "servo_bridge"),
        ("servo_bridge", "virtual_board"),
    }
    for package, executable in ours:
        assert f'"{executable} = ' in (WORKSPACE / package / "setup.py").read_text()
    assert all("namespace" in node for node in nodes)


def test_the_launch_file_sets_parameters_that_exist(described: list[Recorded]) -> None:
    sources = {
        "simulator": REPOSITORY / "softsim_ros" / "simulator",
        "inverse_controller": REPOSITORY / "softsim_ros",  # `robot`, as for every node of a robot
        "servo_bridge": REPOSITORY / "servo_bridge",
        "virtual_board": REPOSITORY / "servo_bridge",
    }
    for entity in described:
        if type(entity).__name__ != "Node" or entity.keywords["executable"] not in sources:
            continue
        text = "".join(file.read_text() for file in sources[entity.keywords["executable"]].glob("*.py"))
        for parameters in entity.keywords["parameters"]:
            for name in parameters:
                declared = re.search(rf"^    {name}: \w+ = parameter\(", text, re.MULTILINE)
                assert declared, f"{entity.keywords['executable']} declares no parameter {name}"
