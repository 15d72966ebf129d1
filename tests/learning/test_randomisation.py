"""What differs from episode to episode: scene values, devices, and what a calibration left open."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("gymnasium")
pytest.importorskip("numba")

from softsim_core import ConfigError, Simulation
from softsim_core.base import FieldError
from softsim_core.lab.learning import (
    Delay,
    Devices,
    RobotEnv,
    SpreadDescription,
    load_randomisation,
    round_to_steps,
)

OWN = """
name: soft_and_slow
parameters:
  modulus: {uniform: [180.0e+3, 320.0e+3]}
  mass: {normal: [0.032, 0.004], bounds: [0.025, 0.040]}
  delay: {log_uniform: [0.04, 0.16]}
scene:
  bodies: [{name: silicone, material: {young_modulus: = modulus}, total_mass: = mass}]
devices: {command_latency: = delay}
"""
POSTERIOR = """
name: calibrated
robot: tripod
names: [modulus]
units: [Pa]
mean: [250.0e+3]
covariance: [[1.0e+8]]
lower: [200.0e+3]
upper: [300.0e+3]
overlay: {bodies: [{name: silicone, material: {young_modulus: = modulus}}]}
"""


def test_scene_values_differ_from_episode_to_episode_and_come_again_with_the_seed(tmp_path: Path) -> None:
    file = tmp_path / "own.yaml"
    file.write_text(OWN)
    environment = RobotEnv("TripodReach-v0", randomise=file)
    drawn = [environment.reset(seed=4)[1], environment.reset()[1]]
    assert drawn[0]["modulus"] != drawn[1]["modulus"]
    seen = []
    for _ in range(2):
        observation, info = environment.reset(seed=4)
        assert info["modulus"] == drawn[0]["modulus"]
        for _ in range(3):
            observation, *_ = environment.step(np.full(3, 0.5, dtype=np.float32))
        seen.append(observation.tobytes())
        material = environment.episodes.batch.call(0, "material", "silicone")
        assert material.values["young_modulus"] == pytest.approx(info["modulus"])
        mass = environment.episodes.batch.call(0, "model").mass.sum()
        assert mass == pytest.approx(info["mass"])
    assert seen[0] == seen[1]


def test_a_randomised_episode_is_the_run_of_that_scene(tmp_path: Path) -> None:
    file = tmp_path / "own.yaml"
    file.write_text(OWN)
    environment = RobotEnv(
        "TripodReach-v0", randomise=file, devices={"command_noise": 0.0, "command_step": 0.0}
    )
    _, info = environment.reset(seed=2)
    episodes = environment.episodes
    overlay = {
        "bodies": [
            {
                "name": "silicone",
                "material": {"young_modulus": info["modulus"]},
                "total_mass": info["mass"],
            }
        ]
    }
    single = Simulation(episodes.task.description(overlay))
    single.start_animation()
    for _ in range(21):  # until the robot stands as it is mounted
        single.step()
    for command, steps in episodes.task.lead_in():
        single.command(command)
        for _ in range(steps):
            single.step()
    late = round(info["delay"] / (episodes.task.steps * single.dt))
    assert 1 <= late <= 4
    for k in range(8):
        environment.step(np.full(3, 0.5, dtype=np.float32))
        if k >= late:
            single.command([-0.7] * 3)
        for _ in range(episodes.task.steps):
            single.step()
    assert episodes.batch.array("positions")[0].tobytes() == single.positions.tobytes()


def test_a_calibration_is_drawn_from(tmp_path: Path) -> None:
    (tmp_path / "posterior.yaml").write_text(POSTERIOR)
    (tmp_path / "with.yaml").write_text(
        "posterior: posterior.yaml\nscene: {contact: {friction: = modulus / 1e6}}\n"
    )
    for name in ("posterior.yaml", "with.yaml"):
        randomisation = load_randomisation(tmp_path / name)
        random = np.random.default_rng(0)
        values = [randomisation.draw(random) for _ in range(200)]
        moduli = np.array([each["modulus"] for *_, each in values])
        assert moduli.mean() == pytest.approx(250e3, abs=3e3)
        assert moduli.std() == pytest.approx(10e3, rel=0.2)
        overlay, _, drawn = values[0]
        assert overlay["bodies"][0]["material"]["young_modulus"] == drawn["modulus"]
        if name == "with.yaml":
            assert overlay["contact"]["friction"] == pytest.approx(drawn["modulus"] / 1e6)


@pytest.mark.parametrize(
    ("spread", "low", "high", "middle"),
    [
        ({"uniform": (1.0, 3.0)}, 1.0, 3.0, 2.0),
        ({"log_uniform": (0.1, 10.0)}, 0.1, 10.0, 1.0),
        ({"normal": (2.0, 1.0), "bounds": (1.0, 3.0)}, 1.0, 3.0, 2.0),
    ],
)
def test_spreads(spread: dict[str, tuple[float, float]], low: float, high: float, middle: float) -> None:
    random, described = np.random.default_rng(1), SpreadDescription(**spread)
    values = np.array([described.draw(random) for _ in range(2000)])
    assert low <= values.min() < values.max() <= high
    assert np.median(values) == pytest.approx(middle, rel=0.12)


def test_wrong_files_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "wrong.yaml"
    with pytest.raises(ConfigError, match="no such file"):
        load_randomisation(file)
    for text, what in (
        ("parameters: {a: {uniform: [1.0, 2.0], normal: [0.0, 1.0]}}", "one of uniform"),
        ("parameters: {a: {log_uniform: [0.0, 2.0]}}", "> 0"),
        ("parametres: {}", "parametres"),
    ):
        file.write_text(text)
        with pytest.raises(ConfigError, match=what):
            load_randomisation(file)
    with pytest.raises(FieldError, match="fall into"):
        SpreadDescription(uniform=(0.0, 1.0), bounds=(2.0, 3.0)).draw(np.random.default_rng(0))


def test_a_delay_gives_each_copy_its_own_past() -> None:
    delay, both = Delay(2, 1), np.arange(2)
    delay.begin(0, 2, np.array([-1.0]))
    delay.begin(1, 0, np.array([-1.0]))
    out = [delay.through(both, np.full((2, 1), float(k))).ravel().tolist() for k in range(4)]
    assert out == [[-1.0, 0.0], [-1.0, 1.0], [0.0, 2.0], [1.0, 3.0]]


def test_devices_round_and_check() -> None:
    assert round_to_steps(np.array([0.26, 0.26]), np.array([0.1, 0.0])).tolist() == pytest.approx([0.3, 0.26])
    with pytest.raises(FieldError, match=">= 0"):
        Devices(joint_noise=-1.0)
