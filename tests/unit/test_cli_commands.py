"""The `softsim` command line: what it lists, refuses, and passes on."""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

from softsim_core.scene import load_scene
from softsim_ros.cli import app, main
from softsim_ros.cli.running import NODES
from softsim_ros.cli.upkeep import suite

REPOSITORY = Path(__file__).resolve().parents[2]


def test_help_lists_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    shown = capsys.readouterr().out
    for name, command in app.COMMANDS.items():
        assert name in shown
        assert command.help in shown


def test_an_unknown_command_names_the_known_ones(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fly"]) == 2
    assert "unknown command 'fly'; known commands: up, run, topics" in capsys.readouterr().err


@pytest.mark.parametrize("name", app.COMMANDS)
def test_every_command_explains_itself(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main([name, "--help"])
    assert end.value.code == 0
    assert f"softsim {name}" in capsys.readouterr().out


def test_the_help_loads_neither_numerics_nor_ros() -> None:
    code = (
        "import sys; from softsim_ros.cli import main; main(['--help']);"
        "sys.exit(bool({'numpy', 'scipy', 'numba', 'rclpy', 'serial'} & set(sys.modules)))"
    )
    subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, check=True, stdout=subprocess.DEVNULL)


@pytest.mark.parametrize("words", [["run"], ["run", "nonsense"]])
def test_run_lists_the_nodes(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words) == 2
    assert f"known nodes: {', '.join(NODES)}" in capsys.readouterr().err
    assert main(["run", "teleopp"]) == 2
    assert "unknown node 'teleopp'; did you mean teleop? known nodes:" in capsys.readouterr().err


@pytest.mark.parametrize("name", NODES)
def test_every_node_has_a_main(name: str) -> None:
    pytest.importorskip("rclpy")
    assert callable(importlib.import_module(NODES[name].module).main)


def test_run_hands_ros_arguments_to_the_node() -> None:
    from softsim_ros.cli.running import run

    parser = argparse.ArgumentParser(allow_abbrev=False)
    run.configure(parser)
    arguments = parser.parse_args(["simulator", "--ros-args", "-p", "robot:=tripod", "-r", "__ns:=/a"])
    assert (arguments.node, arguments.rest) == (
        "simulator",
        ["--ros-args", "-p", "robot:=tripod", "-r", "__ns:=/a"],
    )


def test_scenes_names_robots_and_their_files(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scenes", "--paths"]) == 0
    shown = capsys.readouterr().out
    assert "  tripod  " in shown
    assert "tripod.yaml" in shown
    assert "found in: " in shown


@pytest.mark.parametrize("name", ["tripod", "cable_gripper", "tripod_step_3", "tripod_step_4_3"])
def test_a_shown_scene_is_the_scene(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scenes", "--show", name]) == 0
    file = tmp_path / "written.yaml"
    file.write_text(capsys.readouterr().out)
    asked = load_scene(name)
    assert dataclasses.replace(load_scene(file), source=None) == dataclasses.replace(
        asked, source=None, controllers=()
    )


def test_a_shown_scene_tells_meshes_made_in_python_and_mistakes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "own.py"
    file.write_text(
        "from softsim_core.physics.mesh import box_mesh\n"
        "from softsim_core.robots import elastic_body\n"
        "def create_scene(scene):\n"
        "    scene.add(elastic_body('block', box_mesh((0.1, 0.1, 0.1), (1, 1, 1)), total_mass=0.1))\n"
    )
    assert main(["scenes", "--show", str(file)]) == 0
    assert "made in Python: 8 nodes" in capsys.readouterr().out
    assert main(["scenes", "--show", "nothing"]) == 1
    assert capsys.readouterr().err.startswith("softsim scenes: ")


def test_the_suite_passes_its_arguments_to_pytest(tmp_path: Path) -> None:
    parser = argparse.ArgumentParser(allow_abbrev=False)
    suite.configure(parser)
    given = ["--quick", "--workers", "5", "tests/unit", "-k", "codec"]
    arguments, arguments.rest = parser.parse_known_args(given)
    words = suite.command(arguments, tmp_path)
    assert words[-3:] == ["tests/unit", "-k", "codec"]
    assert words[words.index(suite.QUICK) - 1] == "-m"
    assert words[words.index("-n") :][:2] == ["-n", "5"]
    assert str(suite.LIMIT_S[True]) in words


def test_a_namespace_that_ros_does_not_take(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("rclpy")
    assert main(["up", "tripod", "--namespace", "my robot"]) == 2
    assert "'my robot' cannot be a namespace" in capsys.readouterr().err


def test_a_broken_robot_file_is_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("rclpy")
    broken = tmp_path / "broken.yaml"
    broken.write_text("name: broken\nbodys: []\n")
    assert main(["up", str(broken), "--headless"]) == 1
    error = capsys.readouterr().err
    assert error.startswith("softsim: ")
    assert "bodys" in error
    assert "Traceback" not in error


def test_a_node_that_joins_a_robot_without_a_name_gets_none(monkeypatch: pytest.MonkeyPatch) -> None:
    client = pytest.importorskip("softsim_ros.client")
    from softsim_ros.cli.running import run

    for robot, named in (("four", ["-p", "robot:=four"]), ("", [])):
        found = client.RunningRobot(robot, "/")
        monkeypatch.setattr(client, "running_robot", lambda found=found: found)
        assert run._name_running_robot([]) == ["--ros-args", *named, "-r", "__ns:=/"]
