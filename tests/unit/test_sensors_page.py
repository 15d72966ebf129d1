"""What docs/sensors.md shows runs as it stands there."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from softsim_core import Simulation, load_scene
from softsim_core.physics.sensing import sensor_kind, sensor_kinds

SHIPPED = {name for name in sensor_kinds() if "softsim_core" in sensor_kind(name).description.__module__}
PAGE = (Path(__file__).resolve().parents[2] / "docs" / "sensors.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)


def test_the_sensors_of_the_page_fit_the_shipped_finger(tmp_path: Path) -> None:
    (rows,) = blocks("yaml")
    file = tmp_path / "finger.yaml"
    file.write_text(f"extends: {load_scene('sensed_finger').source}\n{rows}")
    simulation = Simulation(load_scene(file), backend="scipy")
    assert {each.kind for each in simulation.scene.sensors} == SHIPPED - {
        "chamber",
        "force_torque",
    }  # of a joint that carries bodies: docs/arm.md
    assert simulation.sensors["skin"].value.shape == (5, 5)


def test_every_kind_is_on_the_page() -> None:
    listed = set(re.findall(r"^\| `(\w+)` \|", PAGE, re.MULTILINE))
    assert listed == SHIPPED


def test_a_kind_of_one_s_own_runs_as_it_is_written() -> None:
    names: dict[str, object] = {}
    (code,) = (each for each in blocks("python") if "register_sensor" in each)
    exec(compile(code, "sensors.md", "exec", dont_inherit=True), names)
    described = names["HeightDescription"](name="up", on="tip")  # type: ignore[operator]
    finger = load_scene("sensed_finger").with_scene(sensors=(described,))
    simulation = Simulation(finger, backend="scipy")
    height = simulation.frames()["tip"].position[2]
    assert np.abs(simulation.sensors["up"].value - height).max() < 5e-3
