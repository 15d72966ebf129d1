"""Joints that somebody else moves: evenly from message to message, over what is commanded, within limits."""

from __future__ import annotations

import numpy as np
import pytest

from softsim_core import Simulation, load_scene
from softsim_ros.nodes.simulator import Commanded


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return Simulation(load_scene("gripper_on_arm"))


def stepped(simulation: Simulation, commanded: Commanded, steps: int) -> np.ndarray:
    """Targets (steps, j) of the next steps."""
    targets = []
    for _ in range(steps):
        commanded.apply(simulation)
        targets.append(simulation.joint_targets)
    return np.array(targets)


def test_a_led_joint_moves_evenly_from_message_to_message(simulation: Simulation) -> None:
    simulation.reset()
    commanded = Commanded(pytest.fail)
    commanded.driven.receive({"base_yaw": 0.0}, 10.0)
    stepped(simulation, commanded, 1)
    for k in range(1, 5):
        commanded.driven.receive({"base_yaw": 0.01 * k, "elsewhere": 3.0}, 10.0 + 0.04 * k)
        way = stepped(simulation, commanded, 4)[:, 0]  # a message every four steps
        assert way == pytest.approx(0.01 * (k - 1) + 0.0025 * np.arange(1, 5), abs=1e-12)
    assert stepped(simulation, commanded, 3)[:, 0] == pytest.approx(0.04)  # silence: it stays


def test_what_is_commanded_moves_the_others(simulation: Simulation) -> None:
    simulation.reset()
    commanded = Commanded(pytest.fail)
    commanded.driven.receive({"base_yaw": 0.2}, 0.0)
    before = stepped(simulation, commanded, 1)[0]
    commanded.command(np.append(np.zeros(6), [0.01, 0.01, 0.01]) + np.append(before[:6] + 0.1, np.zeros(3)))
    after = stepped(simulation, commanded, 1)[0]
    assert after[0] == pytest.approx(0.2)
    assert after[1] == pytest.approx(before[1] + 0.1)
    assert after[6:] == pytest.approx(0.01)


def test_it_stays_within_limits(simulation: Simulation) -> None:
    simulation.reset()
    commanded = Commanded(pytest.fail)
    commanded.driven.receive({"base_yaw": 99.0}, 0.0)
    assert stepped(simulation, commanded, 2)[:, 0] == pytest.approx(2.9)
    assert commanded.clamped == 0
