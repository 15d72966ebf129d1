"""ros2_ws builds with colcon in both modes, and what it installs runs from any working directory."""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from waiting import BUILD_S, DEADLINE_S, spin_until

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGES = {"softsim_core", "softsim_node", "softsim_ros", "servo_bridge", "softsim_bringup"}
EXECUTABLES = {
    "softsim_ros": {"simulator", "teleop", "softsim"},
    "servo_bridge": {"servo_bridge", "virtual_board", "emulated_board"},
}

pytestmark = [pytest.mark.slow, pytest.mark.packaging, pytest.mark.ros]


@pytest.fixture(scope="module", params=["released", "symlinked"])
def workspace(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """ros2_ws, built: what bloom would release, alone; and a copy beside copies of what its links lead to."""
    pytest.importorskip("rclpy")
    if shutil.which("colcon", path=f"{Path(sys.executable).parent}:{os.environ['PATH']}") is None:
        pytest.skip("colcon is not installed (pip install 'softsim[colcon]')")
    checkout = tmp_path_factory.mktemp(request.param)
    if request.param == "released":
        subprocess.run(
            [sys.executable, REPOSITORY / "ros2_ws" / "release_tree.py", checkout / "ros2_ws" / "src"],
            check=True,
        )
        assert not [file for file in checkout.rglob("*") if file.is_symlink()]
    else:
        skipped = shutil.ignore_patterns("__pycache__", "build", "install", "log", ".venv")
        packages = ("softsim_core", "softsim_node", "softsim_ros", "servo_bridge")
        for name in ("ros2_ws", *packages, "benchmarks", "configs", "examples", "tests"):
            shutil.copytree(REPOSITORY / name, checkout / name, symlinks=True, ignore=skipped)
        shutil.copy(REPOSITORY / "pyproject.toml", checkout)
    mode = ["--symlink-install"] if request.param == "symlinked" else []
    done = subprocess.run(
        [sys.executable, "-m", "colcon", "build", *mode],
        cwd=checkout / "ros2_ws",
        env={name: value for name, value in os.environ.items() if name != "PYTHONPATH"},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "5 packages finished" in done.stdout
    return checkout / "ros2_ws"


def in_workspace(workspace: Path, *words: str | Path) -> list[str]:
    """The command line that runs a program with the workspace sourced."""
    line = " ".join(shlex.quote(str(word)) for word in words)
    return ["bash", "-c", f". {shlex.quote(str(workspace / 'install' / 'setup.bash'))} && exec {line}"]


def plain_environment(folder: Path) -> dict[str, str]:
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return kept | {"ROS_LOG_DIR": str(folder), "PYTHONUNBUFFERED": "1", "PYTHONDONTWRITEBYTECODE": "1"}


def test_every_package_and_executable_is_installed(workspace: Path) -> None:
    install = workspace / "install"
    for package in PACKAGES:
        index = install / package / "share" / "ament_index" / "resource_index" / "packages" / package
        assert index.exists()
        assert (install / package / "share" / package / "package.xml").exists()
    for package, names in EXECUTABLES.items():
        assert names <= {file.name for file in (install / package / "lib" / package).iterdir()}
    share = install / "softsim_bringup" / "share" / "softsim_bringup"
    for file in (
        "launch/robot.launch.py",
        "launch/tripod.launch.py",
        "control/tripod_controllers.yaml",
        "foxglove/tripod_foxglove.json",
        "rviz/tripod.rviz",
        "security/simulator.xml",
        "configs/robots/tripod.yaml",
    ):
        assert (share / file).is_file()


def test_colcon_test_finds_tests_in_every_package_and_runs_them(workspace: Path, tmp_path: Path) -> None:
    if not (workspace.parent / "tests").exists():
        pytest.skip("a released tree has no tests of the whole suite")
    for words in (
        ("--pytest-args", "--collect-only"),
        (
            "--packages-select",
            "softsim_bringup",
            "--pytest-args",
            "-k",
            "robot_gets or carry_the_project",
        ),
    ):
        done = subprocess.run(
            [sys.executable, "-m", "colcon", "test", "--return-code-on-test-failure", *words],
            cwd=workspace,
            env=plain_environment(tmp_path),
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        assert "failed" not in done.stdout
    report = ElementTree.parse(workspace / "build" / "softsim_bringup" / "pytest.xml").find("testsuite")
    assert report is not None
    assert (report.get("tests"), report.get("failures"), report.get("errors")) == ("6", "0", "0")


def test_configs_are_found_from_elsewhere(workspace: Path, tmp_path: Path) -> None:
    program = workspace / "install" / "softsim_ros" / "lib" / "softsim_ros" / "softsim"
    done = subprocess.run(
        in_workspace(workspace, program, "scenes", "--paths"),
        cwd=tmp_path,
        env=plain_environment(tmp_path),
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert f"  tripod  {workspace.parent}" in done.stdout
    assert str(REPOSITORY) not in done.stdout


@pytest.mark.parametrize(
    ("package", "name", "arguments", "says"),
    [
        # nothing to compile: the kernels of a copy would take minutes on a busy machine
        ("softsim_ros", "simulator", ("--ros-args", "-p", "backend:=scipy"), "simulating tripod"),
        ("servo_bridge", "virtual_board", (), "virtual board on /dev/pts/"),
        (
            "servo_bridge",
            "servo_bridge",
            ("--ros-args", "-p", "autostart:=configure", "-p", "port:=/dev/no_such_port"),
            "/dev/no_such_port",
        ),
    ],
)
def test_nodes_run_from_elsewhere_and_end_in_order(
    workspace: Path,
    tmp_path: Path,
    ros_domain: int,
    package: str,
    name: str,
    arguments: tuple[str, ...],
    says: str,
) -> None:
    output = tmp_path / "output"
    program = workspace / "install" / package / "lib" / package / name
    with output.open("wb") as stream:
        process = subprocess.Popen(
            in_workspace(workspace, program, *arguments),
            cwd=tmp_path,
            env=plain_environment(tmp_path),
            stdin=subprocess.DEVNULL,
            stdout=stream,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    try:
        spin_until(lambda: says in output.read_text() or process.poll() is not None, BUILD_S)
        assert says in output.read_text(), output.read_text()
        process.send_signal(signal.SIGINT)
        assert process.wait(DEADLINE_S) == 0, output.read_text()
        assert "Traceback" not in output.read_text()
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()


def test_the_teleop_refuses_without_a_terminal(workspace: Path, tmp_path: Path, ros_domain: int) -> None:
    done = subprocess.run(
        in_workspace(workspace, workspace / "install" / "softsim_ros" / "lib" / "softsim_ros" / "teleop"),
        cwd=tmp_path,
        env=plain_environment(tmp_path),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        start_new_session=True,
        check=False,
    )
    assert done.returncode == 1
    assert "needs a terminal" in done.stderr
    assert "Traceback" not in done.stderr
