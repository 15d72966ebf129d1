"""Parts: each builds, each runs alone, and the Tripod part is the Tripod of the YAML file."""

from __future__ import annotations

import inspect
import math
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from softsim_core import Simulation, load_scene
from softsim_core.base import ConfigError, MeshFile, Placement, SceneError
from softsim_core.physics.mechanics import JointLimits
from softsim_core.physics.mesh import TetMesh
from softsim_core.robots import parts
from softsim_core.scene import Controller, Part, RobotDescription, Scene


def described(*items: Any) -> RobotDescription:
    scene = Scene()
    scene.add(items)
    return scene.describe()


def assert_same(one: Any, other: Any, where: str = "scene") -> None:
    """Equal values; numbers to 1e-12."""
    assert type(one) is type(other), where
    if is_dataclass(one):
        for field in fields(one):
            assert_same(getattr(one, field.name), getattr(other, field.name), f"{where}.{field.name}")
    elif isinstance(one, tuple):
        assert len(one) == len(other), where
        for index, (a, b) in enumerate(zip(one, other, strict=True)):
            assert_same(a, b, f"{where}[{index}]")
    elif isinstance(one, float):
        assert one == other or abs(one - other) < 1e-12, where
    else:
        assert one == other, where


@pytest.mark.parametrize("level", ["low", "mid", "high"])
def test_tripod_part_is_the_robot_of_the_config(level: str) -> None:
    robot = load_scene("tripod" if level == "low" else f"tripod_{level}", kind="robots")
    part = parts.tripod(silicone=parts.tripod_silicone(level))  # type: ignore[arg-type]
    assert_same(part.joints, robot.joints)
    assert_same(part.attachments, robot.scene.attachments)
    assert part.effector == robot.scene.effector
    for one, other in zip(part.bodies, robot.scene.bodies, strict=True):
        assert_same(
            (one.material, one.total_mass, one.colour), (other.material, other.total_mass, other.colour)
        )
        for mesh, expected in ((one.mesh, other.mesh), (one.surface, other.surface)):
            assert isinstance(mesh, MeshFile)
            assert isinstance(expected, MeshFile)
            assert mesh.file.samefile(expected.file)
            assert_same(mesh.placement, expected.placement)


def test_other_tripods_are_valid() -> None:
    scene = described(
        parts.tripod(parts.ServoCircle(0.08, 4, angle_shift_deg=90.0), limits=JointLimits(-1.0, 1.0))
    )
    assert scene.joint_names == ("servo_0", "servo_1", "servo_2", "servo_3")
    for joint in scene.joints:
        x, y, z = joint.base.translation
        assert math.hypot(x, y) == pytest.approx(0.08)
        turn = math.radians(joint.base.rotation_deg[2])
        inward = np.array([math.cos(turn), math.sin(turn)])  # local x in the world
        np.testing.assert_allclose(inward, -np.array([x, y]) / 0.08, atol=1e-12)
        assert (z, joint.limits) == (-0.00135, JointLimits(-1.0, 1.0))
    np.testing.assert_allclose(scene.joints[0].base.translation, [0.0, 0.08, -0.00135], atol=1e-12)
    assert [attachment.to for attachment in scene.scene.attachments] == [*scene.joint_names, "free"]


@pytest.mark.parametrize(
    ("options", "targets", "effector"),
    [
        ({"tips": "free", "centre_radius": None}, ["free"] * 3, None),
        ({"tips": "none"}, ["free"], "centre"),
        ({"tips": "none", "centre_radius": None}, [], None),
    ],
)
def test_regions_can_be_left_out(options: dict[str, Any], targets: list[str], effector: str | None) -> None:
    scene = described(parts.tripod(**options))
    assert [attachment.to for attachment in scene.scene.attachments] == targets
    assert scene.scene.effector == effector


def test_free_tips_start_at_the_ends_of_the_arms() -> None:
    for region, joint in zip(parts.tripod(tips="free").attachments[:3], parts.tripod().joints, strict=True):
        x, y, z = joint.base.translation
        assert region.frame.translation == pytest.approx((x, y, z + 0.025))
        assert region.frame.rotation_deg == joint.base.rotation_deg


def test_parts_can_be_used_several_times() -> None:
    mesh = TetMesh(points=np.eye(4, 3), tets=np.array([[0, 1, 2, 3]]))
    scene = described(
        [parts.elastic_body(name, mesh, total_mass=0.1) for name in ("one", "two")],
        [parts.fixing_box(f"hold_{name}", name, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)) for name in ("one", "two")],
        parts.fixing_box("spring", "one", (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), stiffness=10.0),
        parts.servo("a"),
        parts.actuated_arm("b", holds="one", base=Placement(translation=(1.0, 0.0, 0.0))),
        parts.actuated_arm("c", holds="two", tip="end", spring=parts.WheelSpring(10.0, inertia=0.1)),
    )
    assert [body.name for body in scene.scene.bodies] == ["one", "two"]
    assert [each.name for each in scene.scene.attachments] == [
        "hold_one",
        "hold_two",
        "spring",
        "b_tip",
        "end",
    ]
    assert scene.joint_names == ("a", "b", "c")
    assert scene.joints[2].stiffness == 10.0


def test_mistakes() -> None:
    with pytest.raises(SceneError, match="at least one servo, not 0"):
        parts.tripod(parts.ServoCircle(servos=0))
    with pytest.raises(SceneError, match="one body, not 0"):
        parts.tripod(silicone=Part())
    with pytest.raises(ConfigError, match=r"meshes/tripod_huge\.vtk: no such file"):
        parts.tripod_silicone("huge")  # type: ignore[arg-type]


def test_every_part_has_help() -> None:
    for part in (parts.servo, parts.actuated_arm, parts.elastic_body, parts.fixing_box, parts.tripod):
        text = inspect.getdoc(part)  # Python 3.13 strips the indentation itself
        assert text is not None
        for name in part.__code__.co_varnames[: part.__code__.co_argcount]:
            assert f"\n    {name}:" in text, f"{part.__name__}: {name}"


def run(name: str, steps: int) -> Simulation:
    simulation = Simulation(load_scene(name), backend="scipy")
    for _ in range(steps):
        simulation.step()
    return simulation


@pytest.mark.slow
def test_servo_demo_swings_and_loops() -> None:
    simulation = run("parts/servo", 251)
    assert simulation.joint_positions == pytest.approx([math.cos(2 * math.pi * 0.25)], abs=1e-12)
    for _ in range(1000):
        simulation.step()
    assert simulation.joint_positions == pytest.approx([math.cos(2 * math.pi * 0.25)], abs=1e-12)


def test_arm_demo_swings_both_arms() -> None:
    simulation = run("parts/actuated_arm", 126)
    angle = math.cos(2 * math.pi * 0.125)
    assert simulation.joint_positions == pytest.approx([angle, -angle], abs=1e-12)


@pytest.mark.slow
def test_body_demo_sags_around_its_held_hole() -> None:
    simulation = run("parts/elastic_body", 30)
    drop = simulation.model.rest[:, 2] - simulation.positions[:, 2]
    assert drop[simulation.model.region_of_node == -2] == pytest.approx(0.0, abs=1e-12)
    assert 0.001 < drop.max() < 0.050


@pytest.mark.slow
@pytest.mark.parametrize("name", ["parts/tripod", "tripod_step_4_1", "tripod_step_4_2", "tripod_step_4_3"])
def test_arms_move_to_minus_45_degrees_in_one_second(name: str) -> None:
    simulation = run(name, 51)
    assert simulation.joint_positions == pytest.approx([-math.pi / 8] * 3, abs=1e-9)
    for _ in range(50):
        simulation.step()
    assert simulation.joint_positions == pytest.approx([-math.pi / 4] * 3, abs=1e-9)
    simulation.command([0.0, 0.0, 0.0])  # the move is over: it does not take the joints back
    simulation.step()
    assert simulation.joint_targets == pytest.approx([0.0] * 3)


@pytest.mark.slow
def test_what_holds_the_silicone_in_each_step() -> None:
    lowest = {
        name: run(f"tripod_step_{name}", 51).positions[:, 2].min() for name in ("2", "3", "4_1", "4_2", "4_3")
    }
    fallen = 9.81 * 0.01**2 * 51 * 52 / 2  # implicit Euler after 51 steps
    assert lowest["2"] == pytest.approx(-0.005 - fallen, abs=1e-6)
    assert -0.050 < lowest["3"] < -0.005
    assert -0.030 < lowest["4_1"] < 0.025
    assert lowest["4_2"] == pytest.approx(0.025 - fallen, abs=1e-6)
    assert lowest["4_3"] > 0.010


def test_a_users_scene_with_a_key_controller_runs(tmp_path: Path) -> None:
    path = tmp_path / "own.py"
    path.write_text(
        "from softsim_core.robots import servo\n"
        "def create_scene(scene):\n"
        "    scene.add(servo('a'))\n"
        "    @scene.on_key\n"
        "    def turn(simulation, key):\n"
        "        simulation.command([0.3 if key == 'up' else -0.3])\n"
    )
    simulation = Simulation(load_scene(path), backend="scipy")
    simulation.press_key("up")
    simulation.step()
    assert simulation.joint_positions == pytest.approx([0.3])


def test_move_all_is_a_controller() -> None:
    assert isinstance(parts.move_all(1.0, duration=1.0), Controller)
