"""Rigid bodies, cables, chambers, contacts and pulls: messages, and a pull across processes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.shared_robot("tripod")]

from builtin_interfaces.msg import Time  # noqa: E402
from geometry_msgs.msg import PoseArray, PoseStamped, WrenchStamped  # noqa: E402
from rclpy.serialization import deserialize_message, serialize_message  # noqa: E402
from visualization_msgs.msg import Marker, MarkerArray  # noqa: E402

from softsim_core import Simulation, load_scene  # noqa: E402
from softsim_core.base import CommandError  # noqa: E402
from softsim_core.physics.mechanics import rotation_of  # noqa: E402
from softsim_ros import messages  # noqa: E402
from softsim_ros.nodes.simulator import (  # noqa: E402
    FORCE_LENGTH,
    bodies_topology,
    cable_markers,
    cable_places,
    chamber_markers,
    chamber_places,
    collision_markers,
    collision_places,
    contact_markers,
    limited_force,
    pressure_colour,
    pulled_nodes,
)


def rows(points: Any) -> np.ndarray:
    return np.array([[point.x, point.y, point.z] for point in points])


def test_bodies_are_triangles_in_their_own_frames() -> None:
    simulation = Simulation(load_scene("gripper_step_1"))
    floor, cube = bodies_topology(simulation, lambda number, name: f"r/{name}_{number}").markers
    assert (floor.ns, cube.ns) == ("floor", "cube")
    assert (cube.header.frame_id, cube.frame_locked) == ("r/cube_1", True)
    assert cube.type == Marker.TRIANGLE_LIST
    assert len(cube.points) == 36
    np.testing.assert_allclose(np.abs(rows(cube.points)), 0.02)
    assert (cube.color.r, cube.color.g, cube.color.b) == (1.0, 1.0, 0.0)


def test_cables_are_lines_points_and_pull_points() -> None:
    simulation = Simulation(load_scene("cable_finger"), backend="scipy")
    line, dots, pull = cable_markers(simulation, Time(sec=3)).markers
    assert (line.ns, dots.ns, pull.ns) == ("line", "points", "pull")
    assert len(line.points) == 14
    assert len(dots.points) == 13
    assert rows([pull.pose.position])[0].tolist() == [0.003, 0.0105, 0.0125]
    assert line.header.frame_id == "world"
    assert line.header.stamp.sec == 3
    assert len(cable_markers(Simulation(load_scene("gripper_step_3")), Time()).markers) == 2


def inside(points: Any) -> float:
    """Volume in [m^3] that triangles of points pointing out of it go around."""
    a, b, c = np.moveaxis(rows(points).reshape(-1, 3, 3), 1, 0)
    return float(np.einsum("ki,ki->", a, np.cross(b, c)) / 6.0)


@pytest.mark.slow
def test_a_chamber_is_its_closed_hollow_in_the_colour_of_its_pressure() -> None:
    simulation = Simulation(load_scene("pneu_arm"))
    start = inside(chamber_markers(simulation, Time()).markers[0].points)
    simulation.settle([4.0e-6, 0.0, 0.0])
    hollows = chamber_markers(simulation, Time(sec=3)).markers
    assert [(each.ns, each.id, each.type) for each in hollows] == [
        (f"air_{number}", number, Marker.TRIANGLE_LIST) for number in range(3)
    ]
    full, other = hollows[:2]
    assert (full.header.frame_id, full.header.stamp.sec) == ("world", 3)
    assert inside(full.points) - start == pytest.approx(
        4.0e-6, rel=0.1
    )  # curved faces as four triangles each
    assert simulation.joint_positions[0] == pytest.approx(4.0e-6, abs=1e-12)
    assert full.color.r - full.color.b > 0.1 > other.color.r - other.color.b
    assert chamber_markers(Simulation(load_scene("tripod")), Time()).markers == []


def test_colours_of_pressures_go_from_light_to_their_limits() -> None:
    light, red, blue = (pressure_colour(each, -1e4, 5e4) for each in (0.0, 5e4, -1e4))
    assert light.min() > 0.9
    np.testing.assert_allclose(pressure_colour(2.5e4, -1e4, 5e4), 0.5 * (light + red))
    np.testing.assert_allclose(pressure_colour(-2e4, -1e4, 5e4), blue)
    np.testing.assert_allclose(pressure_colour(9e9, -1e4, 5e4), red)
    np.testing.assert_allclose(pressure_colour(-1.0, 0.0, 5e4), light)


def test_contact_forces_carry_the_cube() -> None:
    simulation = Simulation(load_scene("gripper_step_1"))
    points, forces = contact_markers(simulation, Time()).markers
    assert len(points.points) == len(forces.points) == 0
    for _ in range(100):
        simulation.step()
    points, forces = contact_markers(simulation, Time()).markers
    ends = rows(forces.points).reshape(-1, 2, 3)
    np.testing.assert_allclose(ends[:, 0], rows(points.points))
    total = (ends[:, 1] - ends[:, 0]).sum(axis=0) / FORCE_LENGTH
    assert abs(total[2]) == pytest.approx(0.03 * 9.81, rel=1e-3)


def test_collision_surfaces_are_triangles_and_spheres_in_the_world() -> None:
    simulation = Simulation(load_scene("tripod_ball"))
    body, ball, *_ = collision_markers(simulation, Time()).markers
    assert (body.ns, body.type, ball.ns, ball.type) == (
        "silicone",
        Marker.TRIANGLE_LIST,
        "ball",
        Marker.SPHERE,
    )
    silicone = simulation.collision_surfaces[0]
    corners = simulation.collision_points[silicone.triangles].reshape(-1, 3)
    np.testing.assert_allclose(rows(body.points), corners)
    assert ball.scale.x == pytest.approx(0.026)
    np.testing.assert_allclose(rows([ball.pose.position])[0], simulation.rigid_poses[0].position)
    assert collision_markers(Simulation(load_scene("tripod")), Time()).markers == []


@pytest.mark.parametrize(
    "scene",
    ["tripod_ball", "cable_gripper", "tripod", pytest.param("pneu_finger", marks=pytest.mark.slow)],
)
def test_moving_markers_are_those_built_from_objects(scene: str) -> None:
    simulation = Simulation(load_scene(scene))
    cables = messages.MovingMarkers(cable_markers(simulation, Time()).markers)
    surfaces = messages.MovingMarkers(collision_markers(simulation, Time()).markers)
    chambers = messages.MovingMarkers(chamber_markers(simulation, Time()).markers)
    for _ in range(5):
        simulation.step()
    now = Time(sec=7, nanosec=8)
    for data, built in (
        (cables.fill(now, *cable_places(simulation)), cable_markers(simulation, now)),
        (chambers.fill(now, *chamber_places(simulation)), chamber_markers(simulation, now)),
        (surfaces.fill(now, *collision_places(simulation)), collision_markers(simulation, now)),
    ):
        sent = deserialize_message(serialize_message(built), MarkerArray)  # colours become float32
        assert deserialize_message(data, MarkerArray) == sent


def test_a_pull_on_a_point_or_frame_keeps_its_sum() -> None:
    simulation = Simulation(load_scene("tripod"), backend="scipy")
    force = np.array([1.0, -2.0, 0.5])
    for place in ("mesh_point/0", "mesh_point/100", "centre"):
        forces = pulled_nodes(simulation, place, force)
        np.testing.assert_allclose(forces.sum(axis=0), force, atol=1e-12)
    for place in ("mesh_point/99999", "mesh_point/-1", "servo_0", ""):
        with pytest.raises(CommandError, match=r"no place .* mesh_point/0 to mesh_point/\d+.*centre"):
            pulled_nodes(simulation, place, force)


def test_a_pull_on_a_frame_has_its_axes_and_on_a_point_the_world_s() -> None:
    simulation = Simulation(load_scene("tripod"), backend="scipy")
    simulation.command(np.array([-1.0, -0.5, -0.5]))
    for _ in range(30):
        simulation.step()
    force = np.array([0.0, 0.0, 1.0])
    turn = rotation_of(simulation.frames()["centre"].quaternion_xyzw)
    assert np.linalg.norm(turn @ force - force) > 0.02
    np.testing.assert_allclose(
        pulled_nodes(simulation, "centre", force).sum(axis=0), turn @ force, atol=1e-12
    )
    np.testing.assert_allclose(pulled_nodes(simulation, "mesh_point/0", force).sum(axis=0), force, atol=1e-12)


def test_forces_are_shortened_and_checked() -> None:
    np.testing.assert_allclose(limited_force((3.0, 0.0, 4.0), 1.0), [0.6, 0.0, 0.8])
    np.testing.assert_allclose(limited_force((0.0, 0.0, 0.4), 1.0), [0.0, 0.0, 0.4])
    np.testing.assert_allclose(limited_force((0.0, 0.0, 0.0), 0.0), 0.0)
    with pytest.raises(CommandError, match="must be finite"):
        limited_force((0.0, float("nan"), 0.0), 1.0)


@pytest.mark.slow
def test_a_pull_moves_the_body_and_is_let_go(tripod: Any, spin_until: Any) -> None:
    poses = tripod.client.collect(PoseStamped, "effector_pose")
    assert spin_until(lambda: poses)
    message = WrenchStamped()
    message.header.frame_id = "tripod/effector"
    message.wrench.force.y = 5.0

    def pulled() -> bool:
        tripod.client.publish("external_wrench", message)
        return bool(abs(poses[-1].pose.position.y) > 1e-3)

    assert spin_until(pulled)
    message.wrench.torque.x = 0.1
    tripod.client.publish("external_wrench", message)
    assert tripod.warns("pull refused: only forces pull; leave the torque 0")
    assert spin_until(lambda: abs(poses[-1].pose.position.y) < 1e-4)


@pytest.mark.slow
def test_a_base_goes_where_a_message_says_and_a_wrong_name_is_a_warning(tripod: Any, spin_until: Any) -> None:
    frames = tripod.client.collect(PoseArray, "frames")
    assert spin_until(lambda: frames)
    place = 1 + 2 * 1  # the effector's frame, then base and horn of each servo
    start = frames[-1].poses[place].position
    message = messages.base_target(Time(), "servo_1", (start.x, start.y, start.z + 0.005))

    def moved() -> bool:
        tripod.client.publish("base_target", message)
        return bool(abs(frames[-1].poses[place].position.z - start.z - 0.005) < 1e-9)

    assert spin_until(moved)
    message.joint_names = ["servo_9"]

    def warned() -> bool:
        tripod.client.publish("base_target", message)
        return bool(tripod.warns("no joint 'servo_9' has a base"))

    assert spin_until(warned)
    message.joint_names = ["servo_1", "servo_1"]
    tripod.client.publish("base_target", message)
    assert tripod.warns("2 joint names with 1 transforms; name one joint a message")
    assert tripod.trigger("reset")[0]
    assert spin_until(lambda: frames[-1].poses[place].position.z == start.z)
