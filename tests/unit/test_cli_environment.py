"""Defaults of the environment: set where absent, kept where present; a mixed ROS is refused."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from softsim_node import discovery, environment

REPOSITORY = Path(__file__).resolve().parents[2]


def wheels(prefix: Path) -> Path:
    (prefix / "lib" / "python3.12" / "site-packages" / "ros_wheels_bootstrapper").mkdir(parents=True)
    return prefix


@pytest.mark.parametrize(
    ("wish", "ros", "taken", "told"),
    [
        ("", "", "LOCALHOST", "reached by nodes on this computer only (domain 0, LOCALHOST; SOFTSIM_"),
        ("", "SUBNET", "LOCALHOST", "nodes on this computer only"),  # what a sourced ROS sets by itself
        ("", "OFF", "OFF", "reached by no other process"),
        ("SUBNET", "LOCALHOST", "SUBNET", "anybody there can move the robot"),
        ("OFF", "SUBNET", "OFF", "reached by no other process"),
    ],
)
def test_discovery_stays_on_this_computer_unless_the_user_wishes_otherwise(
    tmp_path: Path, wish: str, ros: str, taken: str, told: str
) -> None:
    given = {discovery.WISH: wish, discovery.RANGE: ros, "ROS_LOCALHOST_ONLY": "1", "HOME": str(tmp_path)}
    variables = {name: value for name, value in given.items() if value}
    environment.set_defaults(variables, tmp_path)
    assert variables[discovery.RANGE] == taken
    assert "ROS_LOCALHOST_ONLY" not in variables
    assert told in discovery.sentence(variables)


def test_rclpy_starts_in_one_place_which_prepares_the_environment() -> None:
    places = [
        str(file.relative_to(REPOSITORY))
        for package in ("softsim_node", "softsim_ros", "servo_bridge")
        for file in (REPOSITORY / package).rglob("*.py")
        if "rclpy.init(" in file.read_text()
    ]
    assert places == ["softsim_node/process.py"]


def test_an_unknown_discovery_range_is_refused_with_what_is_allowed() -> None:
    with pytest.raises(discovery.DiscoveryError, match="'everybody' is refused; allowed: LOCALHOST, SUBNET"):
        discovery.wished_range({discovery.WISH: "everybody"})


def test_computers_named_by_hand_are_told() -> None:
    assert "the computers in ROS_STATIC_PEERS (10.0.0.7)" in discovery.sentence({discovery.PEERS: "10.0.0.7"})


def test_the_wheels_index_is_found_beside_an_overlay(tmp_path: Path) -> None:
    variables = {"HOME": str(tmp_path), "AMENT_PREFIX_PATH": "/overlay"}
    prefix = wheels(tmp_path / "venv")
    for _ in range(2):  # a child process must not add it twice
        environment.set_defaults(variables, prefix)
        assert variables["AMENT_PREFIX_PATH"].split(os.pathsep) == ["/overlay", str(prefix)]


def test_without_wheels_the_index_is_the_system_s(tmp_path: Path) -> None:
    variables = {"HOME": str(tmp_path)}
    environment.set_defaults(variables, tmp_path)
    assert "AMENT_PREFIX_PATH" not in variables


def test_logs_go_elsewhere_where_home_cannot_be_written(tmp_path: Path) -> None:
    home = tmp_path / "home"
    home.write_text("a file, so that no folder can be made below it, whoever runs this")
    variables = {"HOME": str(home)}
    environment.set_defaults(variables, tmp_path)
    assert not variables["ROS_LOG_DIR"].startswith(str(home))
    variables = {"HOME": str(tmp_path)}
    environment.set_defaults(variables, tmp_path)
    assert "ROS_LOG_DIR" not in variables


@pytest.mark.parametrize("variable", ["AMENT_PREFIX_PATH", "PYTHONPATH", "LD_LIBRARY_PATH"])
def test_a_sourced_system_ros_is_seen(variable: str) -> None:
    assert environment.system_ros({variable: "/home/me/overlay:/opt/ros/jazzy/lib"}) == "/opt/ros/jazzy/lib"
    assert environment.system_ros({variable: "/home/me/overlay"}) is None


@pytest.mark.ros
def test_mixing_is_refused_in_one_sentence() -> None:
    if not environment.has_ros_wheels(Path(sys.prefix)):
        pytest.skip("ROS does not come from the wheels here")
    done = subprocess.run(
        [sys.executable, "-m", "softsim_ros.cli", "scenes"],
        cwd=REPOSITORY,
        env={**os.environ, "AMENT_PREFIX_PATH": "/opt/ros/jazzy"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert "/opt/ros/jazzy) is active in this terminal and cannot be mixed" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
@pytest.mark.ros
def test_the_mark_of_another_environment_does_no_harm() -> None:
    if not environment.has_ros_wheels(Path(sys.prefix)):
        pytest.skip("ROS does not come from the wheels here")
    clean = {name: value for name, value in os.environ.items() if name != "LD_LIBRARY_PATH"}
    done = subprocess.run(
        [sys.executable, "-m", "softsim_ros.cli", "doctor"],
        cwd=REPOSITORY,
        env={**clean, environment.BOOTSTRAP_MARK: "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert "rclpy (pip wheels) with rmw_" in done.stdout
