"""What is felt of contacts: resultants and tactile arrays, against the weights that rest on them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from contact_scenes import downhill, loose, touching
from scipy.spatial.transform import Rotation
from small_scenes import GRAVITY, body

from softsim_core import Simulation
from softsim_core.base import Box, Placement
from softsim_core.physics.mesh import Shape, box_mesh
from softsim_core.physics.sensing import TactileArrayDescription, WrenchSensorDescription
from softsim_core.scene import AttachmentDescription, RigidBodyDescription, SceneDescription

SIDE, EDGE, MASS = 0.06, 0.03, 0.1
"""Of the pad, and edge in [m] and mass in [kg] of the cube on it."""
TOP = 0.01


def pad(*cubes: float, gravity: tuple[float, float, float], seed: int = 0) -> SceneDescription:
    """Cubes of these masses in [kg], one on another, on a pad of rubber that is held below."""
    soft = body(
        box_mesh((SIDE, SIDE, TOP), (8, 8, 1), (-SIDE / 2, -SIDE / 2, 0.0)),
        "pad",
        young_modulus=4e5,
        total_mass=0.03,
    )
    held = AttachmentDescription(
        name="held", body="pad", to="world", box=Box(center=(0.0, 0.0, 0.0), size=(1.0, 1.0, 1e-4))
    )
    rigid = [
        loose(f"cube_{k}", Shape(box=(EDGE,) * 3), TOP + 0.001 + EDGE / 2 + k * (EDGE + 0.001), mass)
        for k, mass in enumerate(cubes)
    ]
    return touching(
        *rigid,
        soft=(soft,),
        attachments=(held,),
        gravity=gravity,
        friction=0.9,
        backend="scipy",
        rayleigh_stiffness=0.05,
        rayleigh_mass=2.0,
    )


def array(turn: float, rows: int, columns: int) -> TactileArrayDescription:
    """A tactile array over the pad's upper face, its axes turned by `turn` [deg] about the vertical."""
    box = Box(center=(0.0, 0.0, TOP), size=(0.1, 0.1, 0.002), rotation_deg=(0.0, 0.0, turn))
    return TactileArrayDescription(name="skin", body="pad", box=box, rows=rows, columns=columns)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.slow
def test_a_resting_weight_on_a_tilted_array(seed: int) -> None:
    """Sum of pressure times area: the weight across the pad; their centre: below the cube's centre."""
    rng = np.random.default_rng(seed)
    angle, heading, turn = rng.uniform(0.05, 0.25), rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.0, 90.0)
    rows, columns = rng.integers(8, 24, 2).tolist()
    scene = pad(MASS, gravity=downhill(angle, heading))
    simulation = Simulation(replace(scene, sensors=(array(turn, rows, columns),)))
    for _ in range(120):
        simulation.step()
    pressures = simulation.sensors["skin"].value
    assert pressures.shape == (rows, columns)

    corners = np.array([(x, y, 0.0) for x in (-SIDE / 2, SIDE / 2) for y in (-SIDE / 2, SIDE / 2)])
    axes = Rotation.from_euler("z", turn, degrees=True)
    seen = axes.inv().apply(corners)[:, :2]
    low, edges = seen.min(axis=0), np.ptp(seen, axis=0) / (columns, rows)
    forces = pressures * edges.prod()
    assert forces.sum() == pytest.approx(MASS * GRAVITY * np.cos(angle), rel=1e-2)
    middles = [low[k] + edges[k] * (np.arange(n) + 0.5) for k, n in enumerate((columns, rows))]
    centre = [forces.sum(axis=0) @ middles[0], forces.sum(axis=1) @ middles[1]] / forces.sum()
    offset = (EDGE / 2 + 0.001) * np.tan(angle)  # the line of weight through the cube's centre
    below = simulation.rigid_poses[0].position + offset * np.array([np.cos(heading), np.sin(heading), 0.0])
    np.testing.assert_allclose(centre, axes.inv().apply(below)[:2], atol=5e-4)


@pytest.mark.slow
def test_wrenches_of_a_stack_are_the_weights_above() -> None:
    gravity = downhill(0.1, 0.7)
    masses, weights = (0.1, 0.04), [mass * np.array(gravity) for mass in (0.1, 0.04)]
    sensors = (
        WrenchSensorDescription(name="pad", body="pad"),
        WrenchSensorDescription(name="upper", body="cube_0", other="cube_1"),
        WrenchSensorDescription(name="lower", body="cube_0", other="pad", on="cube_0"),
        WrenchSensorDescription(name="both", body="cube_0", on="cube_0"),
        WrenchSensorDescription(name="none", body="cube_1", other="pad"),
    )
    simulation = Simulation(replace(pad(*masses, gravity=gravity), sensors=sensors))
    for _ in range(200):
        simulation.step()
    told = {name: simulation.sensors[name].value for name in simulation.sensors}
    lower, upper = simulation.rigid_poses
    turn = Rotation.from_quat(lower.quaternion_xyzw)
    whole = sum(weights)
    moment = sum(
        np.cross(pose.position, weight) for pose, weight in zip((lower, upper), weights, strict=True)
    )
    np.testing.assert_allclose(told["pad"], np.concatenate([whole, moment]), atol=5e-3 * MASS * GRAVITY)
    np.testing.assert_allclose(told["upper"][:3], weights[1], atol=5e-3)
    np.testing.assert_allclose(told["lower"][:3], turn.inv().apply(-whole), atol=1e-2)
    np.testing.assert_allclose(told["both"][:3], turn.inv().apply(-weights[0]), atol=5e-3)
    np.testing.assert_allclose(told["both"][3:], 0.0, atol=1e-4)  # at rest, about the centre of mass
    assert (told["none"] == 0.0).all()


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.slow
def test_a_rigid_plate_feels_where_a_soft_foot_stands(seed: int) -> None:
    """Two triangles carry the whole face: the force is felt below the foot, nowhere else."""
    rng = np.random.default_rng(seed)
    at, side = rng.uniform(-0.02, 0.02, 2), 0.02
    mesh = box_mesh((side,) * 3, (3, 3, 3), (at[0] - side / 2, at[1] - side / 2, 0.0011))
    foot = body(mesh, "foot", young_modulus=3e5, total_mass=MASS)
    plate = RigidBodyDescription(
        name="plate", shape=Shape(box=(0.1, 0.1, 0.01)), pose=Placement(translation=(0.0, 0.0, -0.005))
    )
    box = Box(center=(0.0, 0.0, 0.0), size=(0.2, 0.2, 0.002))
    skin = TactileArrayDescription(name="skin", body="plate", box=box, rows=50, columns=40)
    scene = touching(plate, soft=(foot,), backend="scipy", rayleigh_stiffness=0.02, rayleigh_mass=2.0)
    simulation = Simulation(replace(scene, sensors=(skin,)))
    for _ in range(100):
        simulation.step()
    forces = simulation.sensors["skin"].value * (0.1 / 50) * (0.1 / 40)
    assert forces.sum() == pytest.approx(MASS * GRAVITY, rel=1e-2)
    y, x = (0.1 * ((np.arange(n) + 0.5) / n - 0.5) for n in forces.shape)
    centre = np.array([forces.sum(axis=0) @ x, forces.sum(axis=1) @ y]) / forces.sum()
    np.testing.assert_allclose(centre, at, atol=1.5e-3)
    rows, columns = np.nonzero(forces)
    assert np.abs(x[columns] - at[0]).max() < side / 2 + 2.5e-3
    assert np.abs(y[rows] - at[1]).max() < side / 2 + 2.5e-3
