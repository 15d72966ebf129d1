"""Strain of bent beams, lengths and tensions of cables, volumes and pressures of chambers, markers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cable_scenes import bent_bar, cable_joint
from small_scenes import body, scene, slab

from softsim_core import Simulation, load_scene
from softsim_core.physics.mechanics import JointLimits
from softsim_core.physics.mesh import box_mesh
from softsim_core.physics.sensing import (
    CableSensorDescription,
    ChamberSensorDescription,
    MarkersDescription,
    StrainSensorDescription,
)

LENGTH, EDGE, YOUNG = 0.1, 0.01, 1e6
"""Of a beam of square section, in [m] and [Pa]."""


@pytest.mark.parametrize("seed", range(3))
def test_the_strain_of_a_beam_bent_by_a_force_at_its_end(seed: int) -> None:
    """Mean of M(x) z / (E I) along the line, M = P (L - x), about both axes at once."""
    rng = np.random.default_rng(seed)
    sides = rng.choice([-1.0, 1.0], 2) * EDGE / 2
    load = np.sign(sides) * rng.uniform(1e-3, 5e-3, 2) * rng.choice([-1.0, 1.0])  # in [N], towards an edge
    first, last = np.sort(rng.choice(np.arange(1, 9), 2, replace=False)) * LENGTH / 10
    line = tuple((float(x), *map(float, sides)) for x in np.linspace(first, last, 3))
    mesh = box_mesh((LENGTH, EDGE, EDGE), (10, 1, 1), (0.0, -EDGE / 2, -EDGE / 2))
    beam = replace(body(mesh, "beam", young_modulus=YOUNG, poisson_ratio=0.0), order=2)
    sensor = StrainSensorDescription(name="bend", body="beam", points=line)
    simulation = Simulation(
        scene(
            beam,
            attachments=(slab("root", "world", 0.0, "beam"),),
            gravity=(0.0, 0.0, 0.0),
            sensors=(sensor,),
        ),
        backend="scipy",
    )
    assert simulation.sensors["bend"].value == 0.0
    tip = np.flatnonzero(np.isclose(simulation.model.rest[:, 0], LENGTH))
    simulation.forces[tip, 1:] = load / len(tip)
    simulation.settle([])
    moment = LENGTH - 0.5 * (first + last)  # mean of L - x over the line
    expected = -(load @ sides) * moment / (YOUNG * EDGE**4 / 12.0)
    assert abs(expected) > 1e-4
    assert simulation.sensors["bend"].value == pytest.approx(expected, rel=1e-2)


def test_a_cable_s_length_and_tension() -> None:
    sensor = CableSensorDescription(name="tendon_sensor", joint="tendon")
    tendon = cable_joint(control="force", limits=JointLimits(lower=0.0, upper=2.0))
    simulation = Simulation(bent_bar(tendon, sensors=(sensor,)), backend="scipy")
    for tension in (0.0, 0.4, 0.9):
        simulation.command([tension])
        for _ in range(20):
            simulation.step()
        points = simulation.actuators[0].points
        length, force = simulation.sensors["tendon_sensor"].value
        assert length == pytest.approx(np.linalg.norm(np.diff(points, axis=0), axis=1).sum(), rel=1e-12)
        assert force == pytest.approx(tension, abs=1e-12)
    assert length < 0.083  # 84 mm at rest


def test_a_chamber_s_volume_and_pressure() -> None:
    cube = load_scene("inflated_cube")
    (joint,) = cube.joints
    sensor = ChamberSensorDescription(name="air_sensor", joint=joint.name, pressure_bias=100.0)
    simulation = Simulation(cube.with_scene(sensors=(sensor,)), backend="scipy")
    volumes = []
    for _ in range(2):
        corners = simulation.actuators[0].surface
        volumes.append(
            abs(np.einsum("ki,ki->k", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum()) / 6
        )
        told, pressure = simulation.sensors["air_sensor"].value
        assert told == pytest.approx(volumes[-1], rel=1e-9)
        assert pressure == simulation.joint_efforts[0] + 100.0
        simulation.command([joint.limits.upper])
        for _ in range(20):
            simulation.step()
    assert volumes[1] > 1.001 * volumes[0]


@pytest.mark.slow
def test_markers_are_seen_with_a_camera_s_noise_and_gaps() -> None:
    """Across the line of sight and along it noise has its own size, and each marker its own gaps."""
    mesh = box_mesh((0.1, 0.01, 0.01), (5, 1, 1))
    places = ((0.02, 0.005, 0.01), (0.05, 0.0, 0.003), (0.1, 0.01, 0.01))
    camera = (0.3, -0.4, 0.5)
    sensor = MarkersDescription(
        name="markers", points=places, noise=1e-3, depth_noise=4e-3, camera=camera, dropout=0.2, seed=5
    )
    true = MarkersDescription(name="true", points=places, body="body")
    simulation = Simulation(
        scene(body(mesh), attachments=(slab("root", "world", 0.0),), sensors=(sensor, true)), backend="scipy"
    )
    np.testing.assert_allclose(simulation.sensors["true"].value, places, atol=1e-15)
    errors = []
    for _ in range(600):
        simulation.step()
        errors.append(simulation.sensors["markers"].value - simulation.sensors["true"].value)
    away = np.array(errors)
    lost = np.isnan(away).all(axis=2)
    assert (np.isnan(away).any(axis=2) == lost).all()
    assert lost.mean() == pytest.approx(0.2, abs=0.03)
    assert np.corrcoef(lost.T)[0, 1] == pytest.approx(0.0, abs=0.15)
    sight = simulation.sensors["true"].value - np.array(camera)
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    along = np.einsum("tpi,pi->tp", away, sight)
    across = away - along[:, :, None] * sight
    assert np.nanstd(along) == pytest.approx(4e-3, rel=0.1)
    assert np.sqrt(np.nanmean((across**2).sum(axis=2)) / 2.0) == pytest.approx(1e-3, rel=0.1)
