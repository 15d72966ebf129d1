"""Modules that have moved can be imported by their former names until release 0.3.0."""

from __future__ import annotations

import dataclasses
import importlib
import importlib.util
import re
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import pytest
from faces import face

import servo_bridge
import softsim_core
import softsim_node
import softsim_ros
from softsim_core import MOVED
from softsim_core.base import FormerNames, find_former_names
from softsim_core.lab.meshing import MeshedPart
from softsim_core.physics import sensing

REPOSITORY = Path(__file__).resolve().parents[2]

FINDERS = [finder for finder in sys.meta_path if isinstance(finder, FormerNames)]

DOCUMENTED = {
    "servo_bridge.driver": ("ServoDriver",),
    "servo_bridge.servo": ("angles_to_bytes", "bytes_to_angles"),
    "servo_bridge.virtual_board": ("VirtualBoard",),
    "softsim_core.arrays": ("Array", "IndexArray"),
    "softsim_core.editing": ("SceneDocument",),
    "softsim_core.editing.parts": ("add_attachment",),
    "softsim_core.fem.elements": ("ElementData", "element", "register_element"),
    "softsim_core.fem.materials": ("Material", "MaterialParameter", "register_material"),
    "softsim_core.inverse.closed_loop": ("read_closed_loop_log",),
    "softsim_core.linalg.linear_solver": ("Pattern", "Rows", "spread_of"),
    "softsim_core.linalg.solvers": ("register_linear_solver",),
    "softsim_core.mesh": ("write_tets",),
    "softsim_core.mesh.shapes": ("Shape",),
    "softsim_core.meshing": ("MeshingOptions", "mesh_part"),
    "softsim_core.observer.observer": ("Observer",),
    "softsim_core.scene.yaml_loader": ("load_yaml",),
    "softsim_core.scene.objects": ("CollisionDescription",),
    "softsim_core.values": ("Box", "Placement", "Vector"),
}
"""What documentation, examples and scenes imported before, where it needs no ROS."""

WITH_ROS = {
    "softsim_node.spinning": ("serve_callbacks",),
    "softsim_ros.client.session": ("connect",),
    "softsim_ros.messages.contacts": ("read_contact_cloud",),
    "softsim_ros.state_listener": ("StateListener",),
}

WITH_GYMNASIUM = {
    "softsim_core.learning.environments": ("RobotEnv",),
    "softsim_core.learning.policy": ("load_policy",),
    "softsim_core.learning.tasks": ("REACHED_M",),
}


def check_names(module: str, names: tuple[str, ...]) -> None:
    # A former name warns at its first import; a package by its own name must not be made anew.
    if (loaded := sys.modules.get(module)) is not None and loaded.__name__ != module:
        del sys.modules[module]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = importlib.import_module(module)
    if found.__name__ != module:  # a package that has its former name is no former name
        assert any(f"{module} has moved: use {found.__name__};" in str(each.message) for each in caught)
    for name in names:
        assert hasattr(found, name)


@pytest.mark.parametrize(("module", "names"), DOCUMENTED.items())
def test_what_was_documented_is_found(module: str, names: tuple[str, ...]) -> None:
    check_names(module, names)


@pytest.mark.ros
@pytest.mark.parametrize(("module", "names"), WITH_ROS.items())
def test_what_was_documented_of_nodes_is_found(module: str, names: tuple[str, ...]) -> None:
    pytest.importorskip("rclpy")
    check_names(module, names)


@pytest.mark.parametrize(("module", "names"), WITH_GYMNASIUM.items())
def test_what_was_documented_of_learning_is_found(module: str, names: tuple[str, ...]) -> None:
    pytest.importorskip("gymnasium")
    check_names(module, names)


def test_a_former_name_gives_the_same_module() -> None:
    sys.modules.pop("softsim_core.errors", None)
    with pytest.warns(DeprecationWarning, match="errors has moved: use softsim_core.base.errors"):
        former = importlib.import_module("softsim_core.errors")
    present = importlib.import_module("softsim_core.base.errors")
    assert former is present
    assert present.__name__ == present.__spec__.name == "softsim_core.base.errors"  # type: ignore[union-attr]


@pytest.mark.parametrize("package", [servo_bridge, softsim_core, softsim_node, softsim_ros])
def test_every_new_name_is_a_module(package: object) -> None:
    tables = [finder._modules for finder in FINDERS]
    assert MOVED in tables
    name = package.__name__  # type: ignore[attr-defined]
    (table,) = (table for table in tables if all(old.startswith(f"{name}.") for old in table))
    for old, new in table.items():
        assert not REPOSITORY.joinpath(*old.split(".")).with_suffix(".py").exists(), old
        assert importlib.util.find_spec(new) is not None, new


def test_no_former_name_hides_a_public_one() -> None:
    """An import of `old.name` sets `name` in what is now the package of `old`."""
    for finder in FINDERS:
        for old in finder._modules:
            package, _, name = old.rpartition(".")
            assert name not in face(finder._new_name(package) or package), old


def test_a_program_runs_by_its_former_name_and_warns() -> None:
    words = [sys.executable, "-m", "softsim_core.warmup", "--help"]
    ended = subprocess.run(words, cwd=REPOSITORY, capture_output=True, text=True, check=True)
    assert "python -m softsim_core.simulation.warmup" in ended.stdout
    words[1:1] = ["-W", "error::DeprecationWarning:runpy"]
    ended = subprocess.run(words, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert "softsim_core.warmup has moved: use softsim_core.simulation.warmup" in ended.stderr


def test_a_script_is_warned_at_its_own_line(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text("from softsim_core.values import Box\n")
    words = [sys.executable, str(script)]
    ended = subprocess.run(words, cwd=REPOSITORY, capture_output=True, text=True, check=True)
    assert f"{script}:1: DeprecationWarning: softsim_core.values has moved" in ended.stderr


def test_a_former_name_of_a_class_gives_the_class_and_warns() -> None:
    for package in (softsim_core, sensing):
        expected = f"{package.__name__}.Seen is now {package.__name__}.StepObservation; release 0.3.0"
        with pytest.warns(DeprecationWarning, match=re.escape(expected)) as caught:
            assert package.Seen is package.StepObservation
        assert caught[0].filename == __file__
        assert "Seen" not in [*package.__all__, *dir(package)]
    with pytest.warns(DeprecationWarning, match="StepObservation"):
        from softsim_core import Seen  # type: ignore[attr-defined]
    assert Seen is softsim_core.StepObservation
    with pytest.raises(AttributeError):
        _ = softsim_core.nothing  # type: ignore[attr-defined]


def test_only_former_names_of_attributes_warn() -> None:
    find = find_former_names("package", {"old": "new"}, {"new": 1, "other": 2}.__getitem__)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert (find("new"), find("other")) == (1, 2)
    with pytest.warns(DeprecationWarning, match=re.escape("package.old is now package.new")):
        assert find("old") == 1


@pytest.mark.filterwarnings("ignore:.* has moved:DeprecationWarning")
def test_a_name_that_nothing_had_is_not_found() -> None:
    for name in ("softsim_core.nothing", "softsim_core.mesh.nothing", "softsim_core.contact.crossing"):
        with pytest.raises(ModuleNotFoundError, match=name):
            importlib.import_module(name)


def test_a_former_name_of_an_attribute_gives_its_value_and_warns() -> None:
    nothing: Any = None
    part = MeshedPart(nothing, nothing, nothing, 0.01, 0.0, ("two holes closed",), True)
    with pytest.warns(
        DeprecationWarning, match=r"MeshedPart\.told is now MeshedPart\.remarks; release 0\.3\.0"
    ):
        assert part.told == ("two holes closed",)
    with pytest.warns(DeprecationWarning, match=r"MeshedPart\.known is now MeshedPart\.from_cache"):
        assert part.known
    assert {"told", "known"}.isdisjoint(each.name for each in dataclasses.fields(MeshedPart))
