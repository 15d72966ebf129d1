"""`softsim excite` through processes: what it records, how it ends, and the chain to a calibrated model."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("rclpy")

from geometry_msgs.msg import Point, Pose, PoseArray, PoseStamped, Quaternion
from node_processes import private_ros
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger
from waiting import spin_until

from softsim_core import load_scene, rotation_exp
from softsim_core.lab.identification import load_data_set, load_session
from softsim_ros.cli import main
from softsim_ros.excitation import (
    ExcitationError,
    SensorChoice,
    drifts,
    not_before,
    rings_from,
    sensor_choice,
    times_of,
)

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.shared_robot("tripod")]

REPOSITORY = Path(__file__).resolve().parents[2]
CLI = "softsim_ros.cli"
READY_S = 120.0
START = load_scene("tripod").start_joints
COARSE = {
    "bodies": [{"name": "silicone", "mesh": {"file": str(REPOSITORY / "configs/meshes/tripod_coarse.vtk")}}]
}
SURE = 5.0
"""Standard errors: a fit of 8 poses is off by more once in 4000 times; by more than 3, in one run of 36."""
ZEROS = (0.04, -0.03, 0.02)
YOUNG = 200.0e3
QUICK = ("--settle", "0.2", "--hold", "0.3", "--speed", "1")


def rows(folder: Path, session: str = "grid") -> int:
    try:
        return len((folder / f"{session}.csv").read_text().splitlines()) - 2
    except OSError:
        return 0


def softsim(*words: str) -> Any:
    return subprocess.run(
        [sys.executable, "-m", CLI, *words],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        timeout=900.0,
        check=False,
    )


def write_scene(file: Path, extends: str, **changes: Any) -> Path:
    file.write_text(yaml.safe_dump({"extends": extends, **changes}))
    return file


@pytest.fixture
def private_domain(tmp_path: Path) -> Iterator[int]:
    """A ROS domain without the shared Tripod."""
    with private_ros(tmp_path) as domain:
        yield domain


def test_the_model_that_moved_is_found_without_error(
    private_domain: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Commands, stamps and the step in which a command acts are the simulator's, at rest and in time."""
    model = write_scene(tmp_path / "model.yaml", str(REPOSITORY / "configs/robots/tripod.yaml"), **COARSE)
    out = tmp_path / "bench"
    words = ("--poses", "3", "--motion", "grid", "--motion", "chirp", "--motion", "ring_down")
    done = softsim(
        "excite", str(model), "--out", str(out), "--chirp", "1.5", "--ringing", "0.5", *words, *QUICK
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "measuring the simulated tripod with effector_pose: about" in done.stdout
    assert "grid: 3 rows, 3 of them count" in done.stdout
    assert main(["validate", str(out), "--json", "--max-max", "0.001"]) == 0
    assert len(json.loads(capsys.readouterr().out)["sessions"]) == 3


@pytest.fixture
def measuring(running_tripod: Any, start_process: Callable[..., Any], spin_until: Any, tmp_path: Path) -> Any:
    """A measurement of the module's Tripod that has taken two poses, and its folder."""
    out = tmp_path / "bench"
    process = start_process(CLI, "excite", "tripod", "--attach", "--out", str(out), "--poses", "27", *QUICK)
    assert spin_until(lambda: rows(out) >= 2 or process.process.poll() is not None, READY_S)
    assert process.process.poll() is None, process.output
    return process, out


def test_ctrl_c_keeps_what_is_recorded_and_brings_the_robot_home(
    measuring: Any, running_tripod: Any, spin_until: Any
) -> None:
    process, out = measuring
    states = running_tripod.client.collect(JointState, "joint_states")
    assert process.end() == 130, process.output
    assert "bench, as far as it came: softsim validate" in process.output
    assert spin_until(lambda: states and list(states[-1].position) == pytest.approx(list(START), abs=1e-3))
    data = load_data_set(out)
    assert len(load_session(data, data.description.sessions[0]).table) >= 2
    assert (out / "calibration.yaml").is_file()


def test_a_motion_that_is_cut_short_is_kept_as_far_as_it_came(
    running_tripod: Any, start_process: Callable[..., Any], tmp_path: Path
) -> None:
    out = tmp_path / "bench"
    process = start_process(
        CLI, "excite", "tripod", "--attach", "--out", str(out), "--motion", "chirp", *QUICK
    )
    assert process.says("chirp ...", READY_S), process.output
    commands = running_tripod.client.collect(Float64MultiArray, "position_controller/commands")
    assert spin_until(lambda: len({each.data[0] for each in commands}) > 30, READY_S)
    assert process.end() == 130, process.output
    (session,) = load_data_set(out).description.sessions
    assert session.name == "chirp"
    assert 10 < len(load_session(load_data_set(out), session).table) < 1100


def test_nobody_else_may_move_the_robot(measuring: Any, running_tripod: Any) -> None:
    process, out = measuring
    points = running_tripod.client.publisher(Float64MultiArray, "position_controller/commands")
    points.publish(Float64MultiArray(data=[-1.0, -1.1, -1.2]))
    assert process.process.wait(READY_S) == 1
    assert "another node commands the joints" in process.output
    assert rows(out) >= 2


def test_an_e_stop_ends_it(
    start_process: Callable[..., Any], client: Any, spin_until: Any, tmp_path: Path
) -> None:
    robot = write_scene(
        tmp_path / "stopped.yaml", str(REPOSITORY / "configs/robots/tripod.yaml"), name="stopped"
    )
    up = start_process(CLI, "up", str(robot), "--headless", "--no-viewer", "--send")
    assert up.says("bridge active", READY_S), up.output
    out = tmp_path / "bench"
    words = ("--attach", "--joints", "real", "--out", str(out), "--poses", "27")
    process = start_process(CLI, "excite", str(robot), *words, *QUICK)
    assert spin_until(lambda: rows(out) >= 2 or process.process.poll() is not None, READY_S)
    assert process.process.poll() is None, process.output
    assert client.call(Trigger, "/stopped/servo_bridge/e_stop").success
    assert process.process.wait(READY_S) == 1
    assert "the e-stop is latched: the servos hold still" in process.output
    assert "the robot is not back in its start pose" in process.output
    data = load_data_set(out)
    told = np.degrees(load_session(data, data.description.sessions[0]).commands(load_scene("tripod")))
    assert told == pytest.approx(np.round(told), abs=1e-4)  # what the bridge applied: bytes of a degree


def test_markers_of_a_camera_and_an_imu_are_recorded(
    running_tripod: Any, start_process: Callable[..., Any], client: Any, tmp_path: Path
) -> None:
    """The camera stands somewhere: its frame is fitted, and a ringing on one line is left out."""
    node, turned = client.node, rotation_exp(np.array([0.0, 0.0, 0.4]))
    points = node.create_publisher(PoseArray, "points", 10)
    shaken = node.create_publisher(Imu, "imu", 10)

    def on_pose(seen: PoseStamped) -> None:
        place = seen.pose.position
        x, y, z = turned @ (place.x, place.y, place.z) + (0.1, 0.0, 0.5)
        message = PoseArray(header=seen.header)
        message.header.frame_id = "camera"
        message.poses = [Pose(position=Point(x=x, y=y, z=z))] * 2
        points.publish(message)
        shaken.publish(Imu(header=seen.header, orientation=Quaternion(w=1.0)))

    subscription = node.create_subscription(PoseStamped, "effector_pose", on_pose, 10)
    out = tmp_path / "bench"
    process = start_process(
        *(CLI, "excite", "tripod", "--attach", "--out", str(out), "--poses", "5", *QUICK),
        *(
            "--sensor",
            "points=effector,centre",
            "--sensor",
            "imu",
            "--motion",
            "grid",
            "--motion",
            "ring_down",
        ),
    )
    assert process.process.wait(READY_S) == 0, process.output
    node.destroy_subscription(subscription)
    assert "ring_down is left out" in process.output
    data = load_data_set(out)
    (grid,) = data.description.sessions
    assert [each.at for each in grid.sensors] == ["effector", "centre"]
    assert grid.alignment.frame
    assert {"imu_qw", "points_1_z_mm", "servo_2_rad"} <= set(
        (out / "grid.csv").read_text().splitlines()[1].split(",")
    )
    assert main(["validate", str(out), "--max-mean", "0.01"]) == 0


def test_a_folder_that_is_there_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["excite", "tripod", "--out", str(tmp_path)]) == 1
    assert "is there already; give another with --out" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("words", [("--reach", "2"), ("--poses", "0"), ("--speed", "0"), ("--chirp", "-1")])
def test_what_cannot_be_played_is_a_sentence(
    words: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["excite", "tripod", "--out", str(tmp_path / "bench"), *words]) == 1
    assert f"{words[0].strip('-')}" in capsys.readouterr().err


def test_sensors_are_named_with_what_they_sit_on() -> None:
    assert sensor_choice("marker") == SensorChoice("marker")
    assert sensor_choice("/cam/points=effector,0.01:0:0.03") == SensorChoice(
        "/cam/points", ("effector", (0.01, 0.0, 0.03))
    )
    for wrong in ("=effector", "a b", "points=0.1:0.2"):
        with pytest.raises(ExcitationError, match="sensor"):
            sensor_choice(wrong)


def test_what_still_moves_is_told_from_noise() -> None:
    random, ramp = np.random.default_rng(0), np.linspace(0.0, 1.0, 12)[:, None] * (1.0, 0.0, 0.0)
    settling = np.exp(-3.0 * ramp[:, :1]) * (0.0, 0.5, 0.0)
    assert drifts(ramp)
    assert drifts(settling)
    noises = [0.2 * random.standard_normal((30, 3)) for _ in range(200)]
    assert np.mean([drifts(each) for each in noises]) < 0.02
    assert not drifts(np.zeros((6, 3)))


def test_a_ringing_counts_from_where_the_joints_stand() -> None:
    times = 0.01 * np.arange(300)
    commands = np.where((times > 0.3) & (times < 0.9), 0.5, 0.0)[:, None]
    noise = 1e-3 * np.random.default_rng(0).standard_normal((300, 3))
    rings = np.exp(-2.0 * times) * np.sin(40.0 * times) * (times > 0.3)
    follows = 5.0 * commands * (1.0, 0.0, 0.0)
    assert rings_from(times, commands, follows + noise + rings[:, None]) == pytest.approx(0.9, abs=0.011)
    assert rings_from(times, commands, follows + noise) == 0.0  # it only follows


def test_stamps_of_another_clock_are_not_used() -> None:
    arrivals = np.linspace(1000.0, 1001.0, 11)
    late = arrivals - 0.02
    assert [each[0] for each in times_of([(late, arrivals), (late + 0.01, arrivals)])] == [999.98, 999.99]
    simulated = arrivals - 995.0
    assert [each[0] for each in times_of([(late, arrivals), (simulated, arrivals)])] == [1000.0, 1000.0]


def test_what_a_late_sensor_says_of_the_pose_before_is_left_out() -> None:
    stamps = np.linspace(10.0, 11.0, 11)
    numbers = stamps[:, None]
    joints, camera = (stamps[5:], stamps[5:] + 0.01, numbers[5:]), (stamps, stamps + 0.3, numbers)
    assert not_before(10.55, [joints, camera])[1][:, 0] == pytest.approx(stamps[6:])
    other_clock = (stamps + 1000.0, stamps + 0.3, numbers)
    assert len(not_before(10.55, [joints, other_clock])[1]) == len(stamps)
    assert len(not_before(None, [joints, camera])[1]) == len(stamps)


def test_the_whole_chain(
    start_process: Callable[..., Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Excite, validate, calibrate, validate: a robot with other zeros and stiffness, seen with noise."""
    model = write_scene(
        tmp_path / "model.yaml", str(REPOSITORY / "configs/robots/tripod.yaml"), name="bench_robot", **COARSE
    )
    reality = write_scene(
        tmp_path / "reality.yaml",
        "model.yaml",
        joints=[{"name": f"servo_{k}", "rest": -zero} for k, zero in enumerate(ZEROS)],
        bodies=[{"name": "silicone", "material": {"young_modulus": YOUNG}}],
    )
    out, found = tmp_path / "bench", tmp_path / "found.yaml"
    robot = start_process(
        "softsim_ros.nodes.simulator.simulator_node",
        *("--ros-args", "-p", f"robot:={reality}", "-p", "publish_clock:=true"),
    )
    assert robot.says("simulating", READY_S), robot.output
    camera = start_process("examples.marker_camera", "bench_robot", "0.1")
    excite = softsim(
        *("excite", str(model), "--attach", "--out", str(out), "--sensor", "marker", "--motion", "grid"),
        *("--poses", "8", "--reach", "0.9", *QUICK),
    )
    assert excite.returncode == 0, excite.stdout + excite.stderr + robot.output + camera.output
    assert camera.end() == 0
    assert robot.end() == 0

    assert main(["validate", str(out), "--max-mean", "0.2"]) == 1
    capsys.readouterr()
    assert main(["calibrate", str(out), "--out", str(found), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    truth = dict(zip(("zero_0", "zero_1", "zero_2"), ZEROS, strict=True)) | {"young": 1e-3 * YOUNG}
    for each in told["parameters"]:
        assert each["found"], each
        error, share = (
            abs(each["value"] - truth[each["name"]]),
            abs(each["standard_error"] / truth[each["name"]]),
        )
        assert error < SURE * each["standard_error"], each
        assert share < 0.2, each
    assert told["sessions"]["grid"]["mean_before_mm"] > 0.6
    assert main(["validate", str(out), "--robot", str(found), "--max-mean", "0.15"]) == 0
