"""Names of the physical parameters of a robot, and the robot with other values of them."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy")

from softsim_core import load_scene
from softsim_core.simulation import Simulation
from softsim_ros.nodes.simulator import tunables, with_values


def test_layers_and_fibres_are_tuned_by_their_names() -> None:
    robot = load_scene("pneu_finger")
    found = tunables(robot)
    assert {"stiffness_factor", "paper.young_modulus", "paper.poisson_ratio", "thread.stiffness"} < set(found)
    changed = with_values(
        robot, {"paper.young_modulus": 2e9, "thread.stiffness": 5e5, "stiffness_factor": 1.5}
    )
    (body,) = changed.scene.bodies
    assert (body.layers[0].young_modulus, body.fibres[0].stiffness) == (2e9, 5e5)
    assert body.material.values["stiffness_factor"] == 1.5
    simulation = Simulation(robot)
    found["thread.stiffness"].write(simulation, 4e5)
    assert found["thread.stiffness"].read(simulation) == 4e5
    assert found["paper.young_modulus"].read(simulation) == found["paper.young_modulus"].value == 1e9


def test_several_bodies_name_their_parameters() -> None:
    names = set(tunables(load_scene("cable_gripper")))
    assert {"finger_1.young_modulus", "finger_3.poisson_ratio", "rayleigh_mass"} < names
