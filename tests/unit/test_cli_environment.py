"""Defaults of the environment: set where absent, kept where present; a mixed ROS is refused."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from sampled_cases import sampled

from softsim_node import environment

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
    given = {
        environment.DISCOVERY_VARIABLE: wish,
        environment.RANGE: ros,
        "ROS_LOCALHOST_ONLY": "1",
        "HOME": str(tmp_path),
    }
    variables = {name: value for name, value in given.items() if value}
    environment.set_defaults(variables, tmp_path)
    assert variables[environment.RANGE] == taken
    assert "ROS_LOCALHOST_ONLY" not in variables
    assert told in environment.describe_range(variables)


def test_rclpy_starts_in_one_place_which_prepares_the_environment() -> None:
    places = [
        str(file.relative_to(REPOSITORY))
        for package in ("softsim_node", "softsim_ros", "servo_bridge")
        for file in (REPOSITORY / package).rglob("*.py")
        if "rclpy.init(" in file.read_text()
    ]
    assert places == ["softsim_node/process.py"]


def test_an_unknown_discovery_range_is_refused_with_what_is_allowed() -> None:
    with pytest.raises(
        environment.DiscoveryError, match="'everybody' is refused; allowed: LOCALHOST, SUBNET"
    ):
        environment.requested_range({environment.DISCOVERY_VARIABLE: "everybody"})


def test_computers_named_by_hand_are_told() -> None:
    assert "the computers in ROS_STATIC_PEERS (10.0.0.7)" in environment.describe_range(
        {environment.PEERS: "10.0.0.7"}
    )


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


def installed(prefix: Path, *names: str) -> dict[str, str]:
    """An environment of ROS with this middleware."""
    folder = prefix / "share/ament_index/resource_index/rmw_typesupport"
    folder.mkdir(parents=True)
    for name in (*names, "rmw_implementation"):
        (folder / name).touch()
    return {"AMENT_PREFIX_PATH": str(prefix)}


@pytest.mark.parametrize("domain", ["300", "233", "-1", "x", "1e2", " 7", "\u0663", "9" * 40])
def test_a_domain_that_does_not_exist_is_one_message(domain: str) -> None:
    (told,) = environment.ros_problems({"ROS_DOMAIN_ID": domain})
    assert "from 0 to 232" in told


@pytest.mark.parametrize("domain", ["", "0", "7", "101", "232"])
def test_domains_that_exist_are_allowed(domain: str) -> None:
    assert environment.ros_problems({"ROS_DOMAIN_ID": domain}) == []


def test_middleware_that_is_not_installed_is_one_message(tmp_path: Path) -> None:
    variables = installed(tmp_path, "rmw_fastrtps_cpp")
    (told,) = environment.ros_problems({**variables, "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"})
    assert "'rmw_cyclonedds_cpp' is refused; installed here: rmw_fastrtps_cpp; or unset it" in told
    assert environment.ros_problems({**variables, "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"}) == []
    assert environment.ros_problems({"RMW_IMPLEMENTATION": "rmw_anything"}) == []  # nothing to compare with


@pytest.mark.parametrize("home", [None, "", "/proc/nobody"])
def test_a_service_without_a_home_writes_its_logs_into_a_private_folder(
    tmp_path: Path, home: str | None
) -> None:
    variables = {"XDG_RUNTIME_DIR": str(tmp_path)} | ({} if home is None else {"HOME": home})
    environment.set_defaults(variables, tmp_path)
    assert variables["ROS_LOG_DIR"] == str(tmp_path / "ros-log")


COMMANDS = [("topics",), ("run", "simulator"), ("doctor",), ("scenes",)]
WRONG = {"RMW_IMPLEMENTATION": "rmw_other_cpp", "ROS_DOMAIN_ID": "300"}


def softsim(*words: str, **variables: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "softsim_ros.cli", *words],
        env={**os.environ, **variables},
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "variable"), sampled("words", [(words, variable) for words in COMMANDS for variable in WRONG])
)
def test_a_variable_that_ends_ros_is_one_message(words: tuple[str, ...], variable: str) -> None:
    pytest.importorskip("rclpy")
    done = softsim(*words, **{variable: WRONG[variable]})
    if words == ("scenes",):
        assert (done.returncode, done.stderr) == (0, "")  # it needs no ROS
        return
    said = done.stdout + done.stderr
    assert done.returncode == 1, said
    assert said.count(f"{variable}='{WRONG[variable]}' is refused; ") == 1
    assert words == ("doctor",) or len(done.stderr.splitlines()) == 1


@pytest.mark.ros
@pytest.mark.slow
def test_ros_starts_without_a_home(ros_domain: int) -> None:
    code = "import softsim_node.process as process\nwith process.ros_process(): print('up')"
    without = {name: value for name, value in os.environ.items() if name not in ("HOME", "ROS_LOG_DIR")}
    done = subprocess.run(
        [sys.executable, "-c", code], env=without, capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.stdout, done.stderr) == ("up\n", "")


def test_the_middleware_is_not_set_up_by_a_file_of_the_current_folder() -> None:
    variables: dict[str, str] = {}
    environment.set_range(variables)
    assert variables["SKIP_DEFAULT_XML_FILE"] == "1"
    variables["SKIP_DEFAULT_XML_FILE"] = "0"  # who wants it says so
    environment.set_range(variables)
    assert variables["SKIP_DEFAULT_XML_FILE"] == "0"


@pytest.mark.parametrize(("chosen", "expected"), [(None, "1"), ("2", "2")])
def test_openblas_has_one_thread_unless_the_user_chose_a_number(chosen: str | None, expected: str) -> None:
    variables = {} if chosen is None else {"OPENBLAS_NUM_THREADS": chosen}
    environment.limit_blas_threads(variables)
    assert variables == {"OPENBLAS_NUM_THREADS": expected}


def test_numpy_starts_no_threads_below_a_command() -> None:
    count = (
        "import os, softsim_ros.cli as cli; assert cli.run_command(['scenes']) == 0\n"
        "import numpy; print(len(os.listdir('/proc/self/task')))"
    )
    variables = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    done = subprocess.run(
        [sys.executable, "-c", count], env=variables, capture_output=True, text=True, check=True
    )
    assert done.stdout.split()[-1] == "1"
