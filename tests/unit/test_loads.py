"""Loads as actuators: forces, moments and accelerations of a command, with directions fixed in space."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from softsim_core.base import Array, SceneError, Vector
from softsim_core.physics.actuation import LoadDescription, MomentLoad, Placed
from softsim_core.physics.mechanics import rotation_exp
from softsim_core.scene import (
    AttachmentDescription,
    BodyDescription,
    JointDescription,
    MaterialDescription,
    RodDescription,
    RodSectionDescription,
    SceneDescription,
)
from softsim_core.scene.building import surroundings
from softsim_core.simulation import Simulation

LENGTH, WIDE, YOUNG, DENSITY = 0.2, 0.006, 2e7, 1200.0
BEND = YOUNG * np.pi * WIDE**4 / 64.0
TIP = (LENGTH, 0.0, 0.0)


def loaded(gravity: Vector = (0.0, 0.0, 0.0), **fields: Any) -> Simulation:
    """A round cantilever with one load."""
    section = RodSectionDescription(shape="ellipse", size=(WIDE, WIDE))
    rod = RodDescription(centreline=((0.0, 0.0, 0.0), TIP), section=section, elements=10)
    body = BodyDescription(
        name="rod",
        rod=rod,
        material=MaterialDescription(law="rod", young_modulus=YOUNG, poisson_ratio=0.3),
        density=DENSITY,
    )
    joint = JointDescription(name="load", kind="load", actuator=LoadDescription(body="rod", **fields))
    clamp = AttachmentDescription(name="clamp", body="rod", to="world", end="start")
    scene = SceneDescription(
        name="loaded", gravity=gravity, bodies=(body,), joints=(joint,), attachments=(clamp,)
    )
    return Simulation(scene, backend="scipy")


def tip(simulation: Simulation) -> Array:
    return np.asarray(simulation.positions[-3:].mean(axis=0))


def test_an_acceleration_is_gravity() -> None:
    by_load, by_gravity = (
        loaded(acceleration=(0.0, 0.0, -1.0)),
        loaded(gravity=(0.0, 0.0, -3.0), force=(1.0, 0.0, 0.0), point=TIP),
    )
    by_load.settle([3.0])
    by_gravity.settle([0.0])
    assert np.abs(by_load.positions - by_gravity.positions).max() < 1e-9
    assert tip(by_load)[2] < -1e-3


def test_a_force_is_one_on_the_nodes() -> None:
    by_load, by_nodes = (loaded(force=(0.0, 0.0, 1.0), point=TIP) for _ in range(2))
    by_load.settle([0.02])
    by_nodes.forces[-3:, 2] = 0.02 / 3.0
    by_nodes.settle([0.0])
    assert np.abs(tip(by_load) - tip(by_nodes)).max() < 1e-8
    assert by_load.joint_positions[0] == pytest.approx(tip(by_load)[2], abs=1e-9)
    assert by_load.joint_efforts[0] == 0.02


def test_a_moment_bends_a_rod_to_a_circle() -> None:
    simulation, angle = loaded(moment=(0.0, -1.0, 0.0), point=TIP, patch=0.004), 1.0
    simulation.settle([angle * BEND / LENGTH])
    radius = LENGTH / angle
    circle = [radius * np.sin(angle), 0.0, radius * (1.0 - np.cos(angle))]
    assert np.abs(tip(simulation) - circle).max() < 1e-3 * LENGTH
    assert simulation.joint_positions[0] == pytest.approx(angle, rel=2e-3)


@pytest.mark.parametrize("seed", range(3))
def test_a_moment_stays_in_space_and_its_stiffness_is_the_symmetric_part(seed: int) -> None:
    simulation, rng = loaded(moment=(0.0, 0.6, 0.8), point=TIP, patch=0.004), np.random.default_rng(seed)
    load = MomentLoad(
        Placed("load", 0, simulation.scene.joints[0].actuator),
        surroundings(simulation.model, simulation.bodies),
    )
    model, state, size = simulation.model, simulation.model.rest_state(), 0.3
    turned = state.positions @ rotation_exp(rng.uniform(-2.0, 2.0, 3)).T
    state.positions[:] = turned + 1e-4 * rng.standard_normal(turned.shape)
    forces = size * load.row(model, state)
    assert np.abs(forces.sum(axis=0)).max() < 1e-10 * np.abs(forces).max()
    moment = np.cross(state.positions[load.place], forces).sum(axis=0)
    np.testing.assert_allclose(moment, [0.0, 0.18, 0.24], atol=1e-9)

    slope, h = np.empty((forces.size, forces.size)), 1e-8
    for column in range(forces.size):
        way = np.zeros(forces.size)
        way[column] = h
        ends = []
        for sign in (1.0, -1.0):
            moved = model.rest_state()
            moved.positions[:] = state.positions
            moved.positions[load.place] += sign * way.reshape(-1, 3)
            ends.append(size * load.row(model, moved).ravel())
        slope[:, column] = (ends[0] - ends[1]) / (2.0 * h)
    rows, weight = load.geometric_stiffness(model, state, size)
    matrix = rows.coefficient.reshape(rows.height, -1)
    found = matrix.T @ np.diag(weight) @ matrix
    assert np.abs(found + 0.5 * (slope + slope.T)).max() < 1e-5 * np.abs(slope).max()


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"point": TIP}, "exactly one of force, moment and acceleration"),
        ({"point": TIP, "force": (1.0, 0.0, 0.0), "moment": (1.0, 0.0, 0.0)}, "exactly one of"),
        ({"force": (1.0, 0.0, 0.0)}, "need a point"),
        ({"acceleration": (1.0, 0.0, 0.0), "point": TIP}, "need a point"),
        ({"point": TIP, "force": (2.0, 0.0, 0.0)}, "force must be"),
        ({"point": TIP, "moment": (1.0, 0.0, 0.0), "patch": 0.0}, "patch must be"),
    ],
)
def test_wrong_loads_are_refused(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        LoadDescription(body="rod", **fields)


def test_a_moment_needs_nodes_around_it() -> None:
    with pytest.raises(SceneError, match="are on a line; increase patch"):
        loaded(moment=(1.0, 0.0, 0.0), point=TIP, patch=1e-6)


def test_a_moment_survives_a_diverged_state() -> None:
    simulation = loaded(moment=(0.0, 1.0, 0.0), point=TIP, patch=0.004)
    load = MomentLoad(
        Placed("load", 0, simulation.scene.joints[0].actuator),
        surroundings(simulation.model, simulation.bodies),
    )
    state = simulation.model.rest_state()
    state.positions[:] = np.nan
    assert np.isnan(load.value(simulation.model, state))
    assert load.geometric_stiffness(simulation.model, state, 1.0).rows.height == 0
