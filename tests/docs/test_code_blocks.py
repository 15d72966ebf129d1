"""Every code block of the documentation runs, is read as the program reads it, or says why not.

Commands of the suite are parsed by their own parsers, and those of `RUN` are run. Python runs page by page,
a page in a process of its own. Keys of YAML are those of the descriptions. `<!-- not run: REASON -->`
before a block takes it out.
Tutorials have more: tests/tutorials.
"""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from doc_pages import PAGES, REPOSITORY, TUTORIALS, Fence, commands, fences, parsed_command

import softsim_core
from softsim_core.physics.actuation import actuator_kinds
from softsim_core.physics.fem.materials import material, material_names
from softsim_ros.cli import run_command as main
from softsim_ros.cli.running import NODES

LANGUAGES = {"", "console", "bash", "python", "yaml", "json", "text"}
SHELL = {"", "console", "bash"}
FENCES = [fence for page in PAGES if TUTORIALS not in page.parents for fence in fences(page)]
FENCES += [fence for page in sorted(TUTORIALS.glob("*.md")) for fence in fences(page)]
COMMANDS = [fence for fence in FENCES if fence.language in SHELL and not fence.reason]
YAML = [fence for fence in FENCES if fence.language == "yaml" and not fence.reason]

OUTSIDE = {
    "pip": "fetches packages",
    "sudo": "changes the machine",
    "git": "needs the repository's address",
    "python": "makes environments, builds",
    "python3": "makes environments, builds",
    "rosdep": "needs ROS's apt source",
    "source": "needs apt's ROS 2",
    "export": "means the shell that reads it",
    "cd": "means the shell that reads it",
    "echo": "means the user's own start files",
    "avrdude": "writes to a board",
    "dask": "needs other computers",
    "helm": "needs a cluster",
    "kubectl": "needs a cluster",
    "pre-commit": "fetches its tools",
    ".ci/run": "runs this test, and all others",
}
"""Programs of others that the text names, and why no test runs them."""

RUN = ("scenes", "material", "urdf", "completion")
"""Commands that end by themselves and soon: they run as they stand, in an empty folder."""

OWN_KEYS = {
    "joints", "cable", "servo_0", "servo_1", "servo_2", "motor_0", "q", "shoulder_pitch", "elbow_pitch",
    "wrist_pitch", "prefix", "safety_limits",
    "modulus", "delay", "command_latency", "uniform", "normal", "log_uniform", "<<",
    "minimise", "maximise",
}  # fmt: skip
"""Keys that are names which a file gives, or forms of values."""

NODE = """
import rclpy
rclpy.init()
node = rclpy.create_node("reader")
"""
BEFORE = {
    "architecture": NODE
    + """
from dataclasses import dataclass
from softsim_node import LiveParameters, parameter
refuse_by_raising = use = lambda names, values: None
""",
    "client": NODE + "from softsim_core import load_scene\nfrom softsim_ros.client import RobotClient\n",
    "interfaces": NODE,
    "edit": """
from pathlib import Path
from softsim_core import box_mesh, write_tets
write_tets(Path("my_finger.vtk"), box_mesh((0.01, 0.01, 0.06), (2, 2, 6)))
""",
    "sensors": """
from builtin_interfaces.msg import Time
from softsim_core import Simulation, load_scene
from softsim_ros.messages import contact_cloud
message = contact_cloud(Time(), "world", Simulation(load_scene("tripod_ball"), backend="scipy").contacts)
""",
    "mesh": f"""
shutil.copy({str(REPOSITORY / "configs/parts/fin_ray_finger.stl")!r}, "finger.stl")
""",
    "sweep": """
import pathlib, yaml
from softsim_core.scene.io import config_file
from softsim_ros.cli import run_command as main
study = yaml.safe_load(config_file("studies/finger_bend.yaml").read_text())
study["design"]["samples"] = 4
pathlib.Path("finger_bend.yaml").write_text(yaml.safe_dump(study))
assert main(["sweep", "finger_bend.yaml", "--workers", "1"]) == 0
""",
}
"""What the text of a page takes for granted, as Python before its blocks."""

NEEDS = {"learning": ("gymnasium",), "mesh": ("pytetwild",), "sweep": ("dask", "zarr", "xarray")}
WITH_ROS = ("architecture", "client", "interfaces", "sensors")


def python_pages() -> list[object]:
    """Pages with Python that runs."""
    found: list[object] = []
    for page in PAGES:
        if TUTORIALS in page.parents:
            continue
        if any(fence.language == "python" and not fence.reason for fence in fences(page)):
            marks = [pytest.mark.slow, *([pytest.mark.ros] if page.stem in WITH_ROS else [])]
            found.append(pytest.param(page, id=page.stem, marks=marks))
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: f"{page.parent.name}/{page.stem}")
def test_blocks_have_languages_that_are_known_and_reasons_are_sentences(page: Path) -> None:
    for fence in fences(page):
        assert fence.language in LANGUAGES, fence
        assert fence.reason is None or len(fence.reason.split()) > 3, fence
    text = page.read_text(encoding="utf-8")
    marked = re.findall(r"^ *<!-- not run:", text, re.MULTILINE)
    assert len(marked) == sum(fence.reason is not None for fence in fences(page))


@pytest.mark.parametrize("page", python_pages())
def test_python_of_a_page_runs(page: Path, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    for package in NEEDS.get(page.stem, ()):
        pytest.importorskip(package)
    if page.stem in WITH_ROS:
        request.getfixturevalue("ros_domain")
    for fence in fences(page):
        named = re.match(r"# (\w+\.yaml)\n", fence.body) or re.match(r"name: (\w+)\n", fence.body)
        if fence.language == "yaml" and named:
            (tmp_path / named[1]).with_suffix(".yaml").write_text(fence.body, encoding="utf-8")
    blocks = [each.body for each in fences(page) if each.language == "python" and not each.reason]
    program = tmp_path / "page.py"
    lines = "\n".join([BEFORE.get(page.stem, ""), *blocks]).splitlines()
    guarded = "\n".join(f"    {line}" if line else "" for line in lines)  # workers import the program, too
    program.write_text(f"if __name__ == '__main__':\n{guarded}\n", encoding="utf-8")
    (tmp_path / "examples").symlink_to(REPOSITORY / "examples")
    path = os.pathsep.join([str(REPOSITORY), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, str(program)],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("fence", COMMANDS, ids=str)
def test_commands_are_known_and_quick_ones_run(
    fence: Fence, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(REPOSITORY)
    for program, *words in commands(fence):
        if program in ("./softsim", "softsim"):
            _softsim(words, tmp_path, monkeypatch)
        elif program == "ros2":
            _ros2(words)
        elif program.startswith(".softsim/venv/bin/"):
            scripts = [word for word in words if word.endswith(".py")]
            assert all((REPOSITORY / script).is_file() for script in scripts), words
        else:
            assert program in OUTSIDE or re.fullmatch(r"\w+=.*", program), (
                f"{program}: in no list of this test"
            )
    capsys.readouterr()


def _softsim(words: list[str], folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name, *rest = words
    if name == "run":
        assert rest[0] in NODES, f"unknown node {rest[0]}"
        return
    if name == "test":  # its options are pytest's, besides its own
        assert all((REPOSITORY / word).exists() for word in rest if word.startswith("tests/")), words
        return
    rest = rest[: next((k for k, word in enumerate(rest) if word in (">", "&")), len(rest))]
    parsed_command(name, rest)
    if name in RUN:
        monkeypatch.chdir(folder)
        assert main([name, *rest]) == 0
        monkeypatch.chdir(REPOSITORY)


def _ros2(words: list[str]) -> None:
    """Commands of apt's ROS 2 that name what the suite has."""
    if words[0] == "run":
        assert words[2] == "softsim" or words[2] in NODES, words
    elif words[0] == "launch":
        launch = next((REPOSITORY / "ros2_ws" / "src").rglob(words[2])).read_text(encoding="utf-8")
        wishes = importlib.import_module("softsim_ros.launch_plan").LaunchArguments
        known = {field.name for field in dataclasses.fields(wishes)}
        for word in words[3:]:
            name = word.split(":=")[0]
            assert name in known or f'"{name}"' in launch, word
    elif words[0] in ("topic", "service") and words[1] in ("pub", "call"):
        package, _, kind = next(word for word in words if re.fullmatch(r"\w+/(msg|srv)/\w+", word)).split("/")
        assert package
        assert kind
        yaml.safe_load(words[-1])


@pytest.mark.parametrize("fence", YAML, ids=str)
def test_keys_of_yaml_are_fields_of_descriptions(fence: Fence) -> None:
    unknown = sorted(_keys(yaml.safe_load(fence.body)) - _fields() - OWN_KEYS)
    assert unknown == []


def _keys(value: object) -> set[str]:
    if isinstance(value, dict):
        # `on:` is a truth value in YAML 1.1, which PyYAML reads
        return {"on" if key is True else str(key) for key in value} | set().union(*map(_keys, value.values()))
    if isinstance(value, list):
        return set().union(*map(_keys, value))
    return set()


def _fields() -> set[str]:
    """Names of the fields of every description, and of the parameters of every material law."""
    found = {"extends", "arm", "tendon_arm", "law", "preset", "stiffness_factor", "prony", *actuator_kinds()}
    for law in material_names():
        found |= {parameter.name for parameter in material(law).parameters}
    for module in [
        softsim_core,
        *(sys.modules[name] for name in list(sys.modules) if "softsim_core" in name),
    ]:
        for kind in vars(module).values():
            if inspect.isclass(kind) and dataclasses.is_dataclass(kind):
                found |= {field.name for field in dataclasses.fields(kind)}
    for name in softsim_core.__all__:
        kind = getattr(softsim_core, name)
        if inspect.isclass(kind) and dataclasses.is_dataclass(kind):
            found |= {field.name for field in dataclasses.fields(kind)}
    return found
