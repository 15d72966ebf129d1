"""Sensors of scenes: rates, noise that is a sensor's own, resets and snapshots, files and their mistakes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from small_scenes import body, machine, scene, slab

from softsim_core import Scene, Simulation, load_scene
from softsim_core.base import Box, ConfigError, Placement, SceneError
from softsim_core.physics.mesh import Shape, box_mesh
from softsim_core.physics.sensing import (
    CableSensorDescription,
    ImuDescription,
    MarkersDescription,
    Reference,
    Scenery,
    Sensor,
    SimulatedSensorDescription,
    StepObservation,
    StrainSensorDescription,
    TactileArrayDescription,
    WrenchSensorDescription,
    register_sensor,
)
from softsim_core.scene import CollisionDescription, RigidBodyDescription, RobotDescription
from softsim_core.scene.io import read_description, write_description

BOX = "{center: [0, 0, 0], size: [1, 1, 1]}"
IMU = ImuDescription(name="imu", on="middle", accelerometer_noise=0.1, gyroscope_noise=0.02, seed=4)


def shaken_values(simulation: Simulation, name: str, steps: int) -> list[np.ndarray]:
    values = []
    for step in range(steps):
        simulation.command([0.01 * np.sin(step), 0.0, 0.0, 0.001 * np.cos(step)])
        simulation.step()
        values.append(simulation.sensors[name].value)
    return values


@pytest.mark.parametrize(("rate", "dt"), [(30.0, 0.01), (7.3, 0.01), (100.0, 0.01), (333.0, 0.002)])
def test_a_rate_is_held_and_values_stay_between_samples(rate: float, dt: float) -> None:
    still = replace(IMU, on="world")
    sensors = (replace(still, rate=rate), replace(still, name="each"))
    simulation = Simulation(scene(dt=dt, sensors=sensors), backend="scipy")
    before, times = simulation.sensors["imu"], []
    for step in range(1, 201):
        simulation.step()
        now = simulation.sensors["imu"]
        assert (now is before) == (now.number == before.number)
        if now is not before:
            times.append(now.time)
            assert now.time == pytest.approx(step * dt)
        before = now
        assert simulation.sensors["each"].number == step
    assert len(times) == before.number == int(200 * dt * rate + 1e-6)
    spaces = np.diff(times)
    assert spaces.max() <= (np.ceil(1.0 / (rate * dt) - 1e-6) + 1e-6) * dt
    assert spaces.min() >= (np.floor(1.0 / (rate * dt) + 1e-6) - 1e-6) * dt


def test_noise_depends_on_seed_and_name_alone() -> None:
    others = (MarkersDescription(name="m", points=((0.03, 0.0, 0.005),), noise=1e-3), replace(IMU, name="z"))
    alone, among, seeded, quiet = (
        shaken_values(Simulation(machine(sensors=sensors), backend="scipy"), "imu", 5)
        for sensors in (
            (IMU,),
            (*others, IMU),
            (replace(IMU, seed=5),),
            (replace(IMU, accelerometer_noise=0.0, gyroscope_noise=0.0),),
        )
    )
    np.testing.assert_array_equal(alone, among)
    away, otherwise = np.array(alone) - quiet, np.array(seeded) - quiet
    assert (np.abs(away) > 0.0).all()
    assert np.abs(np.corrcoef(away[:, :3].ravel(), otherwise[:, :3].ravel())[0, 1]) < 0.8
    renamed = Simulation(machine(sensors=(replace(IMU, name="z"),)), backend="scipy")
    assert not np.isclose(shaken_values(renamed, "z", 5), alone).any()


@pytest.mark.slow
def test_noise_has_the_size_that_is_asked_for_and_a_bias() -> None:
    still = ImuDescription(
        name="imu",
        on="world",
        accelerometer_noise=0.1,
        gyroscope_noise=0.02,
        accelerometer_bias=(0.5, 0.0, 0.0),
        gyroscope_bias=(0.0, 0.0, -0.3),
    )
    simulation, told = Simulation(scene(sensors=(still,)), backend="scipy"), []
    for _ in range(500):
        simulation.step()
        told.append(simulation.sensors["imu"].value)
    values = np.array(told)
    expected = np.array([0.5, 0.0, 9.81, 0.0, 0.0, -0.3])
    deviation = np.array([0.1] * 3 + [0.02] * 3)
    np.testing.assert_allclose(values.mean(axis=0), expected, atol=0.02)
    np.testing.assert_allclose(values.std(axis=0), deviation, rtol=0.15)
    assert np.abs(np.corrcoef(values[1:, 0], values[:-1, 0])[0, 1]) < 0.15


def test_a_reset_begins_the_noise_anew_and_a_snapshot_goes_on_with_it() -> None:
    sensors = (replace(IMU, rate=40.0), replace(IMU, name="each"))
    simulation = Simulation(machine(sensors=sensors), backend="scipy")
    first = simulation.sensors["each"].value
    before = shaken_values(simulation, "each", 4)
    saved = simulation.snapshot()
    after = shaken_values(simulation, "each", 4)
    simulation.restore(saved)
    np.testing.assert_array_equal(shaken_values(simulation, "each", 4), after)
    simulation.reset()
    np.testing.assert_array_equal(simulation.sensors["each"].value, first)
    assert (simulation.sensors["imu"].number, simulation.sensors["imu"].time) == (0, 0.0)
    np.testing.assert_array_equal(shaken_values(simulation, "each", 4), before)


def test_sensors_change_nothing_of_the_motion() -> None:
    plain, felt = (
        Simulation(machine(sensors=sensors), backend="scipy")
        for sensors in (
            (),
            (IMU, StrainSensorDescription(name="s", body="rod", points=((0, 0.03, 0), (0.04, 0.03, 0)))),
        )
    )
    shaken_values(felt, "imu", 10)
    for step in range(10):
        plain.command([0.01 * np.sin(step), 0.0, 0.0, 0.001 * np.cos(step)])
        plain.step()
    np.testing.assert_array_equal(plain.positions, felt.positions)


def test_a_value_cannot_be_written_and_an_unknown_name_is_a_sentence() -> None:
    simulation = Simulation(machine(sensors=(IMU,)), backend="scipy")
    assert list(simulation.sensors) == ["imu"]
    with pytest.raises(ValueError, match="read-only"):
        simulation.sensors["imu"].value[0] = 1.0
    with pytest.raises(SceneError, match="unknown sensor 'nose'; known: imu"):
        simulation.sensors["nose"]
    assert "sensors" in simulation.stage_times
    assert "sensors" not in Simulation(machine(), backend="scipy").stage_times


# --- files ----------------------------------------------------------------------------------------


@pytest.fixture
def described() -> RobotDescription:
    """A robot with a sensor of each kind that needs no more than a bar."""
    parts = Scene(name="felt")
    parts.add(body(box_mesh((0.1, 0.01, 0.01), (5, 1, 1)), "bar"))
    parts.add(slab("root", "world", 0.0, "bar"))
    parts.add(
        [
            StrainSensorDescription(
                name="bend", body="bar", points=((0.0, 0.0, 0.0), (0.05, 0.0, 0.0)), noise=1e-4
            ),
            ImuDescription(name="wall", on="root", rate=50.0, seed=3),
            MarkersDescription(
                name="dots", points=((0.1, 0.0, 0.0),), camera=(0.0, 1.0, 0.0), depth_noise=1e-3
            ),
        ]
    )
    return parts.describe()


def test_sensors_come_from_files_and_go_through_text(described: RobotDescription, tmp_path: Path) -> None:
    told = read_description(write_description(described))
    assert told.scene.sensors == described.scene.sensors
    file = tmp_path / "felt.yaml"
    text = write_description(described.with_scene(bodies=(), attachments=(), sensors=()))
    rows = "- {name: wall, kind: imu, on: world, rate: 50, seed: 3}\n- {name: air, kind: imu, on: world}\n"
    file.write_text(text.replace("sensors: []\n", f"sensors:\n{rows}"))
    over = tmp_path / "over.yaml"
    over.write_text("extends: felt.yaml\nsensors:\n- {name: wall, rate: 20.0}\n")
    wall, air = load_scene(over).scene.sensors
    assert wall == ImuDescription(name="wall", on="world", rate=20.0, seed=3)
    assert air == ImuDescription(name="air", on="world")


@pytest.mark.parametrize(
    ("row", "key", "words"),
    [
        (
            "{name: a}",
            "sensors[0].kind",
            "must be one of wrench, force_torque, tactile, strain, imu, markers, cable, chamber",
        ),
        ("{name: a, kind: nose}", "sensors[0].kind", "not 'nose'"),
        ("3", "sensors[0]", "must be a mapping with keys among name, rate, seed"),
        ("{kind: imu, on: world}", "sensors[0].name", "is missing"),
        ("{name: '', kind: imu, on: world}", "sensors[0].name", "must be a text"),
        (
            "{name: a, kind: imu, on: world, noise: 1.0}",
            "sensors[0].noise",
            "unknown key; did you mean pose? known keys: name, rate",
        ),
        ("{name: a, kind: imu, on: world, rate: 0}", "sensors[0].rate", "must be > 0 Hz, not 0"),
        ("{name: a, kind: imu, on: world, seed: -1}", "sensors[0].seed", "must be >= 0, not -1"),
        ("{name: a, kind: imu, on: world, gyroscope_noise: -1.0}", "sensors[0].gyroscope_noise", ">= 0"),
        (
            "{name: a, kind: imu, on: world, gyroscope_bias: [.inf, 0.0, 0.0]}",
            "sensors[0].gyroscope_bias",
            "finite",
        ),
        (
            "{name: a, kind: imu, on: world, rate: 200}",
            "",
            "rate must be <= 100 Hz, one sample a step of 0.01 s, not 200",
        ),
        ("{name: a, kind: imu, on: tip}", "", "unknown frame 'tip' (on of sensor a); known: world"),
        ("{name: a, kind: wrench, body: nose}", "", "unknown body 'nose' (body of sensor a); known: none"),
        (
            "{name: a, kind: strain, body: nose, points: [[0, 0, 0], [1, 0, 0]]}",
            "",
            "unknown deformable body 'nose'",
        ),
        (
            "{name: a, kind: strain, body: nose, points: [[0, 0, 0]]}",
            "sensors[0].points",
            "at least two points, not 1",
        ),
        (
            "{name: a, kind: strain, body: b, points: [[0, 0, 0], [0, 0, 0]]}",
            "sensors[0].points",
            "apart from each",
        ),
        ("{name: a, kind: markers, points: []}", "sensors[0].points", "at least one point"),
        (
            "{name: a, kind: markers, points: [[0, 0, 0]], dropout: 2}",
            "sensors[0].dropout",
            "in 0 to 1, not 2",
        ),
        (
            "{name: a, kind: markers, points: [[0, 0, 0]], depth_noise: 1}",
            "sensors[0]",
            "depth_noise needs a camera",
        ),
        ("{name: a, kind: cable, joint: nose}", "", "unknown cable 'nose' (joint of sensor a); known: none"),
        ("{name: a, kind: chamber, joint: nose}", "", "unknown chamber 'nose'"),
        (
            f"{{name: a, kind: tactile, body: b, box: {BOX}, rows: 0, columns: 2}}",
            "sensors[0].rows",
            ">= 1",
        ),
        (
            f"{{name: a, kind: tactile, body: b, box: {BOX}, rows: 999, columns: 999}}",
            "sensors[0].rows",
            "at most",
        ),
        (
            "{name: a, kind: imu, on: world}\n- {name: a, kind: imu, on: world}",
            "",
            "two of kind sensor are called a",
        ),
    ],
)
def test_every_mistake_is_one_sentence_with_its_key(row: str, key: str, words: str, tmp_path: Path) -> None:
    file = tmp_path / "felt.yaml"
    file.write_text(f"name: felt\nsensors:\n- {row}\n")
    with pytest.raises(ConfigError) as caught:
        load_scene(file)
    assert caught.value.key == key
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def resting(*sensors: SimulatedSensorDescription) -> Any:
    """A cube over a soft slab."""
    soft = body(box_mesh((0.04, 0.04, 0.01), (2, 2, 1), (-0.02, -0.02, 0.0)), "slab")
    cube = RigidBodyDescription(
        name="cube", shape=Shape(box=(0.02,) * 3), mass=0.03, pose=Placement(translation=(0.0, 0.0, 0.05))
    )
    surfaces = tuple(CollisionDescription(name=name, body=name) for name in ("slab", "cube"))
    return scene(soft, rigid_bodies=(cube,), collisions=surfaces, sensors=sensors)


@pytest.mark.parametrize(
    ("sensor", "words"),
    [
        (
            StrainSensorDescription(name="a", body="slab", points=((0.0, 0.0, 0.0), (0.0, 0.0, 0.5))),
            r"sensor a: point 1 at \[0.0, 0.0, 0.5\] m lies outside body slab, 490 mm from the nearest place",
        ),
        (
            MarkersDescription(name="a", points=((0.0, 0.0, 0.0), (0.0, 0.0, 0.5))),
            r"sensor a: no deformable body is at point 1, \[0.0, 0.0, 0.5\] m",
        ),
        (
            TactileArrayDescription(
                name="a",
                body="slab",
                box=Box(center=(0.0, 0.0, 1.0), size=(1.0, 1.0, 0.1)),
                rows=2,
                columns=2,
            ),
            r"sensor a: no triangle of a collision surface of body slab lies inside its box; move or enlarge",
        ),
        (
            TactileArrayDescription(
                name="a",
                body="slab",
                box=Box(center=(0.02, 0.0, 0.0), size=(0.001, 1.0, 1.0)),
                rows=2,
                columns=2,
            ),
            r"sensor a: along the z axis of its box the patch has no area; turn the box",
        ),
    ],
)
def test_what_does_not_fit_a_body_is_refused(sensor: SimulatedSensorDescription, words: str) -> None:
    with pytest.raises(SceneError, match=words):
        Simulation(resting(sensor))


def test_a_tactile_array_needs_a_surface_that_can_be_touched() -> None:
    box = Box(center=(0.0, 0.0, 0.01), size=(1.0, 1.0, 0.001))
    sensor = TactileArrayDescription(name="a", body="slab", box=box, rows=2, columns=2)
    with pytest.raises(
        SceneError, match="body slab has no collision surface of triangles that can meet another"
    ):
        Simulation(replace(resting(sensor), collisions=()))


def test_a_model_to_plan_with_has_no_sensors() -> None:
    assert (
        RobotDescription(scene=resting(WrenchSensorDescription(name="a", body="cube")))
        .robot_alone()
        .scene.sensors
        == ()
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class HeightDescription(SimulatedSensorDescription):
    """Height of a frame."""

    kind: ClassVar[str] = "height_of_test"
    on: str

    def references(self) -> tuple[Reference, ...]:
        return (Reference("on", self.on, "frame"),)


class Height(Sensor):
    def __init__(self, described: HeightDescription, scenery: Scenery) -> None:
        super().__init__()
        self._place = scenery.places[described.on]

    def measure(self, observation: StepObservation) -> np.ndarray:
        return self._place.pose(observation.model, observation.state)[0][2:]


def test_a_user_s_own_kind_stands_in_files_as_the_package_s(tmp_path: Path) -> None:
    register_sensor(HeightDescription, Height)
    file = tmp_path / "felt.yaml"
    file.write_text("name: felt\nsensors:\n- {name: up, kind: height_of_test, on: world}\n")
    (sensor,) = load_scene(file).scene.sensors
    assert sensor == HeightDescription(name="up", on="world")
    simulation = Simulation(machine(sensors=(HeightDescription(name="up", on="middle"),)), backend="scipy")
    assert simulation.sensors["up"].value == pytest.approx(simulation.frames()["middle"].position[2:])


def test_a_kind_needs_a_name_and_cannot_be_one_of_the_package_s() -> None:
    nameless = type("NamelessDescription", (SimulatedSensorDescription,), {"kind": "no name"})
    with pytest.raises(SceneError, match="sensor kind NamelessDescription refused: give it"):
        register_sensor(nameless, Height)
    with pytest.raises(SceneError, match="sensor kind 'cable' is the package's own"):
        register_sensor(CableSensorDescription, Height)
