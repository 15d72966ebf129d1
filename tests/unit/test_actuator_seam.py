"""Actuators are described and registered in one place."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from softsim_core.base import ConfigError, SceneError
from softsim_core.physics.actuation import (
    ActuatorDescription,
    ActuatorView,
    actuator_kinds,
    register_actuator,
)
from softsim_core.physics.actuation.cable import CableDescription
from softsim_core.scene import JointDescription, load_scene
from softsim_core.simulation import Simulation


def test_an_unknown_kind_is_refused_with_the_known_ones() -> None:
    with pytest.raises(SceneError, match="kind must be one of revolute, prismatic, cable"):
        JointDescription(name="arm", kind="muscle")


def test_a_kind_of_the_package_is_not_replaced() -> None:
    @dataclass(frozen=True, slots=True, kw_only=True)
    class Other(ActuatorDescription):
        kind: ClassVar[str] = "cable"

    with pytest.raises(SceneError, match="actuator kind 'cable' refused"):
        register_actuator(Other, lambda placed, surroundings: pytest.fail("is not built"))
    assert actuator_kinds()["cable"].description is CableDescription


@pytest.mark.parametrize(
    ("joint", "said"),
    [
        ("{name: a, kind: cable}", "`cable` and kind = cable belong together"),
        ("{name: a, cable: {body: b, points: [[0, 0, 0], [1, 0, 0]]}}", "kind = cable belong together"),
        ("{name: a, kind: cable, cable: {body: b, points: [[0, 0, 0]]}}", r"joints\[0\].cable.points: must"),
        ("{name: a, kind: cable, cable: {body: b, pionts: []}}", r"cable.pionts: unknown key; did you mean"),
        ("{name: a, kind: muscle}", r"joints\[0\].kind: must be one of revolute, prismatic, cable"),
        ("{name: a, actuator: {}}", r"joints\[0\].actuator: unknown key"),
    ],
)
def test_files_give_an_actuator_under_the_key_of_its_kind(joint: str, said: str, tmp_path: Path) -> None:
    file = tmp_path / "own.yaml"
    file.write_text(f"name: own\njoints: [{joint}]\n")
    with pytest.raises(ConfigError, match=said):
        load_scene(file)


@pytest.mark.parametrize(("scene", "size"), [("cable_finger", "length"), ("inflated_cube", "volume")])
def test_what_a_sensor_measures_is_linear_in_the_coordinate(scene: str, size: str) -> None:
    simulation = Simulation(load_scene(scene, {"solver": {"backend": "scipy"}}))
    before = simulation.actuators[0].measured_size
    for _ in range(3):
        simulation.step()
    view = simulation.actuators[0]
    assert view.value != 0.0
    assert before.at_zero + before.sign * view.value == pytest.approx(getattr(view, size), rel=1e-12)
    plain = ActuatorView("a", "muscle", np.zeros((0, 3)), 0.25, 1.0)
    assert plain.measured_size == (0.0, 1.0)  # the coordinate itself
