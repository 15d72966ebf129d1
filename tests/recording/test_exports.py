"""Exports hold the numbers of the bag: tables, meshes, the page."""

from __future__ import annotations

import csv
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

pytest.importorskip("rosbags")

from bag_rows import rows, write
from waiting import DEADLINE_S

from softsim_ros.cli import main
from softsim_ros.recording import Bag, mesh_frames

pytestmark = pytest.mark.ros

REPOSITORY = Path(__file__).resolve().parents[2]


def table(file: Path) -> list[dict[str, str]]:
    with file.open(newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.fixture(scope="module")
def tables(robot_bag: Path, tmp_path_factory: Any) -> Path:
    folder = tmp_path_factory.mktemp("tables")
    assert main(["export", str(robot_bag), "--csv", "--out", str(folder)]) == 0
    return folder


def test_joint_states_come_back_from_the_table_digit_for_digit(robot_bag: Path, tables: Path) -> None:
    rows = table(tables / "joint_states.csv")
    with Bag(robot_bag) as bag:
        states = [message for _, message in bag.messages("/tripod/joint_states")]
    assert len(rows) == len(states) == 40
    for row, state in zip(rows, states, strict=True):
        for quantity in ("position", "velocity", "effort"):
            read = [float(row[f"{name}.{quantity}"]) for name in state.name]
            assert read == getattr(state, quantity).tolist()
    assert [float(row["recorded_s"]) for row in rows[:3]] == pytest.approx([0.0, 0.01, 0.02], abs=1e-12)


def test_commands_poses_and_diagnostics_are_tables(tables: Path) -> None:
    commands = table(tables / "position_controller_commands.csv")
    assert [float(row["data.2"]) for row in commands] == (-0.01 * np.arange(40)).tolist()
    pose = table(tables / "effector_pose.csv")[-1]
    assert pose["header.frame_id"] == "world"
    assert float(pose["pose.position.z"]) > 0.02
    reports = table(tables / "diagnostics_tripod_simulator.csv")
    assert [row["message"] for row in reports] == ["running", "running", "slow", "running"]
    assert [row["level"] for row in reports] == ["0", "0", "1", "0"]


def test_meshes_are_no_tables(robot_bag: Path, tmp_path: Path, capsys: Any) -> None:
    assert main(["export", str(robot_bag), "--csv", "--out", str(tmp_path)]) == 0
    assert "not as tables, too long: /tripod/mesh/points, /tripod/mesh/topology" in capsys.readouterr().out


def test_the_vtu_series_holds_points_triangles_and_stress(robot_bag: Path, tmp_path: Path) -> None:
    meshio = pytest.importorskip("meshio")
    assert main(["export", str(robot_bag), "--vtu", "--out", str(tmp_path)]) == 0
    sets = ElementTree.parse(tmp_path / "surface.pvd").getroot().findall("Collection/DataSet")
    with Bag(robot_bag) as bag:
        frames = list(mesh_frames(bag))
    assert [float(each.attrib["timestep"]) for each in sets] == [frame.time_s for frame in frames]
    mesh = meshio.read(tmp_path / sets[-1].attrib["file"])
    assert np.array_equal(mesh.points, frames[-1].points)
    assert np.array_equal(mesh.cells_dict["triangle"], frames[-1].cells)
    assert np.array_equal(mesh.point_data["von_mises"], frames[-1].von_mises)
    assert mesh.point_data["von_mises"].max() > 100.0


def test_a_rate_thins_the_series(robot_bag: Path, tmp_path: Path) -> None:
    pytest.importorskip("meshio")
    assert main(["export", str(robot_bag), "--vtu", "--rate", "10", "--out", str(tmp_path)]) == 0
    assert len(list((tmp_path / "surface").iterdir())) == 4  # 0.4 s


def test_what_is_missing_is_said(tmp_path: Path, capsys: Any) -> None:
    write(tmp_path / "bag", rows(5)).close()
    assert main(["export", str(tmp_path / "bag"), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert "no surface for ParaView: /tripod/mesh/points is not in the bag" in said
    assert "no replay page" in said
    assert main(["report", str(tmp_path / "bag")]) == 0
    page = (tmp_path / "bag_report.html").read_text()
    assert "Left out: holds no surface" in page
    assert "Not in this recording: /tripod/joint_states." in page
    assert "Not in this recording: reports of simulator in /diagnostics." in page
    assert "Not in this recording: /diagnostics." in page


def test_a_bag_that_is_not_there_is_one_sentence(tmp_path: Path, capsys: Any) -> None:
    for command in ("export", "report"):
        assert main([command, str(tmp_path / "nothing")]) == 1
        assert "does not exist; record one with: softsim record" in capsys.readouterr().err


def test_points_of_the_scene_before_are_not_joined_by_the_triangles_of_the_next(tmp_path: Path) -> None:
    pytest.importorskip("rclpy")
    from builtin_interfaces.msg import Time
    from rclpy.serialization import serialize_message

    from softsim_ros import messages

    writer = write(tmp_path / "bag", rows(1))
    kinds = {"mesh/topology": "shape_msgs/msg/Mesh", "mesh/points": "sensor_msgs/msg/PointCloud2"}
    for number, (topic, count) in enumerate(
        [("topology", 4), ("points", 4), ("topology", 3), ("points", 4), ("points", 3)]
    ):
        points, name = np.full((count, 3), float(count)), f"mesh/{topic}"
        message = messages.topology(points, np.array([[0, 1, count - 1]]))
        if topic == "points":
            message = messages.point_cloud(Time(), "world", points, np.zeros(count))
        writer.add_topic(f"/tripod/{name}", kinds[name])
        writer.write(f"/tripod/{name}", 2 * 10**9 + number * 10**7, serialize_message(message))
    writer.close()
    with Bag(tmp_path / "bag") as bag:
        assert [(len(each.points), each.cells.max()) for each in mesh_frames(bag)] == [(4, 3), (3, 2)]


def test_the_curves_of_a_report_run_over_the_seconds_of_the_bag(robot_bag: Path) -> None:
    pytest.importorskip("matplotlib")
    from softsim_ros.recording import charts

    with Bag(robot_bag) as bag:
        found = charts(bag, None)
        stamps = [stamp for stamp, _ in bag.messages("/tripod/effector_pose")]
        expected = 1e-9 * (np.array(stamps) - bag.begin_ns)
    times = {chart.title: curve.times for chart in found for curve in chart.curves if curve.name == "x"}
    assert len(times) == 1
    np.testing.assert_allclose(*times.values(), expected)
    assert 0.1 < expected[-1] < 10.0


def test_a_report_needs_neither_the_web_page_nor_matplotlib_to_begin() -> None:
    """Both are optional: without them the report says what it leaves out."""
    code = (
        "import sys\n"
        "for name in ('viser', 'matplotlib'): sys.modules[name] = None\n"
        "import softsim_ros.recording.report_page\n"
    )
    subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, check=True, timeout=DEADLINE_S)
