"""What the project declares fits what it uses: pins, ROS dependencies, versions."""

from __future__ import annotations

import ast
import importlib.metadata
import re
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import softsim_core
from softsim_ros import LaunchArguments, plan

REPOSITORY = Path(__file__).resolve().parents[2]
LOCKED = re.compile(r"^([a-z0-9._-]+==[^\n\\]+)((?:\\\n    --hash=\S+ ?)*)", re.MULTILINE)
WORKSPACE = REPOSITORY / "ros2_ws" / "src"
PACKAGES = ("softsim_core", "softsim_node", "softsim_ros", "servo_bridge")
ROSDEP = {
    "numpy": "python3-numpy", "scipy": "python3-scipy", "numba": "python3-numba", "meshio": "python3-meshio",
    "yaml": "python3-yaml", "serial": "python3-serial", "matplotlib": "python3-matplotlib",
    "PIL": "python3-pil", "jinja2": "python3-jinja2",
}  # fmt: skip
WITHOUT_KEY = {"lazy_loader"}  # rosdep has no key for it; the package.xml says what to install


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
    names = [name for name in requirements(declared) if name != "softsim"]  # of the extra `all`
    assert {"numpy", "ros-jazzy-rclpy", "pytest"} <= set(names)
    assert [name for name in names if name.lower() not in pinned] == []


def test_what_is_locked_has_hashes_and_the_versions_of_the_pins() -> None:
    packages = LOCKED.findall((REPOSITORY / "requirements.lock").read_text())
    assert len(packages) > 100
    assert [head for head, hashes in packages if not re.search(r"--hash=sha256:[0-9a-f]{64}\b", hashes)] == []
    pinned = {
        line.partition(";")[0].strip() for line in (REPOSITORY / "constraints.txt").read_text().splitlines()
    }
    assert {head.partition(";")[0].strip() for head, _ in packages} <= pinned


def test_all_that_the_environment_needs_is_locked() -> None:
    """What `./softsim` installs is fetched from the lock alone: it has to be whole."""
    text = (REPOSITORY / "requirements.lock").read_text()
    locked = {head.partition("==")[0] for head, _ in LOCKED.findall(text)}
    extras, found = set(re.findall(r"--extra (\w+)", text)), set[str]()
    waiting = [("softsim", frozenset(extras))]
    while waiting:
        name, wanted = waiting.pop()
        for line in importlib.metadata.requires(name) or []:
            need = Requirement(line)
            told = [{"extra": extra} for extra in wanted or [""]]
            if need.marker is None or any(need.marker.evaluate(each) for each in told):
                canonical = canonicalize_name(need.name)
                if canonical not in found:
                    found.add(canonical)
                    waiting.append((need.name, frozenset(need.extras)))
    assert {"numpy", "pytest", "viser"} <= found
    assert found <= locked


@pytest.mark.parametrize(
    "name", ["pyproject.toml", "constraints.txt", "requirements.lock", "softsim", ".ci/run"]
)
def test_no_package_registry_is_named(name: str) -> None:
    assert not re.search(r"https?://|index-url", (REPOSITORY / name).read_text())


@pytest.mark.parametrize("package", [*PACKAGES, "softsim_bringup"])
def test_ros_packages_carry_the_project_s_version_and_licence(package: str) -> None:
    project = (REPOSITORY / "pyproject.toml").read_text()
    assert 'dynamic = ["version"]' in project
    root = ElementTree.parse(WORKSPACE / package / "package.xml").getroot()
    assert (root.get("format"), root.findtext("name")) == ("3", package)
    assert root.findtext("version") == softsim_core.__version__
    assert root.findtext("license") == "Apache-2.0"
    assert f'version="{softsim_core.__version__}"' in (WORKSPACE / package / "setup.py").read_text()
    assert (WORKSPACE / package / "resource" / package).is_file()


@pytest.mark.parametrize("package", PACKAGES)
def test_the_workspace_links_to_the_packages(package: str) -> None:
    link = WORKSPACE / package / package
    assert link.is_symlink()
    assert not link.readlink().is_absolute()
    assert link.resolve() == REPOSITORY / package


def test_what_a_launch_starts_is_named_in_package_xml(tmp_path: Path) -> None:
    root = ElementTree.parse(WORKSPACE / "softsim_bringup" / "package.xml").getroot()
    declared = {element.text for element in root.iter("exec_depend")}
    everything = LaunchArguments(inverse="true", viewer="true", control="true", rviz="true")
    started = {node.package for node in plan(everything, tmp_path).nodes}
    assert {"softsim_ros", "servo_bridge", "controller_manager", "rviz2"} <= started <= declared
    files = (WORKSPACE / "softsim_bringup" / "launch").glob("*.py")
    modules = {
        node.module.split(".")[0]
        for file in files
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.ImportFrom) and node.module
    }
    assert modules - set(sys.stdlib_module_names) <= declared


def test_what_pip_adds_under_ubuntu_is_what_the_project_asks_for() -> None:
    project = (REPOSITORY / "pyproject.toml").read_text()
    asked = set(re.findall(r'^\s+"([a-z0-9-]+[<>=][^";]*)[";]', project, re.MULTILINE))
    lines = (REPOSITORY / "ros2_ws" / "pip-requirements.txt").read_text().splitlines()
    added = {line.partition("#")[0].strip() for line in lines} - {""}
    assert added <= asked
    assert {"daqp", "viser", "rosbags"} <= {re.split("[<>=]", each)[0] for each in added}


@pytest.mark.slow
@pytest.mark.parametrize("package", PACKAGES)
def test_package_xml_names_what_the_code_imports(package: str) -> None:
    root = ElementTree.parse(WORKSPACE / package / "package.xml").getroot()
    declared = {element.text for element in root.iter("exec_depend")}
    used = imports(package) - {package} - WITHOUT_KEY
    # optional imports, behind a test whether they are there
    used -= {"daqp", "pydrake", "mujoco", "ament_index_python", "llvmlite", "rosbags", "viser", "c3d"}
    used -= {"gymnasium", "argcomplete"}
    used -= {"websockets", "imageio", "msgspec", "cmap", "lz4"}  # viser's own, and rosbags'
    assert {ROSDEP.get(name, name) for name in used} - declared == set()
