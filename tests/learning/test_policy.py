"""Policies as ONNX files: the same actions wherever an observation comes from, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("onnxruntime")
pytest.importorskip("numba")
onnx = pytest.importorskip("onnx")

from policy_files import write_policy  # noqa: E402

from softsim_core import load_scene  # noqa: E402
from softsim_core.errors import PolicyError  # noqa: E402
from softsim_core.learning.policy import load_policy, policy_metadata  # noqa: E402
from softsim_core.learning.task import Moment, Senses  # noqa: E402
from softsim_core.learning.tasks import TASKS  # noqa: E402

SHIPPED = Path(__file__).parents[2] / "examples" / "learning" / "tripod_reach.onnx"
PERFECT = dict.fromkeys(
    ("command_latency", "command_noise", "joint_step", "position_noise", "tilt_noise", "force_noise"), 0.0
) | {"rate_noise": 0.0, "joint_noise": 0.0, "effort_noise": 0.0}


@pytest.mark.parametrize("name", TASKS)
def test_senses_of_a_robot_give_the_commands_of_the_environment(name: str, tmp_path: Path) -> None:
    pytest.importorskip("gymnasium")
    from softsim_core.learning.environments import RobotEnv

    policy = load_policy(write_policy(tmp_path / "policy.onnx", name))
    environment = RobotEnv(name, devices=PERFECT)
    observation, _ = environment.reset(seed=3)
    episodes = environment.episodes
    for _ in range(10):
        moment = episodes._moment(np.array([0]))
        senses: Senses = moment
        assert isinstance(moment, Moment)
        wanted = policy.command(senses)
        observation, *_ = environment.step(policy.actions(observation[None])[0])
        assert episodes._wanted[0].tobytes() == wanted[0].tobytes()
    environment.close()


def test_a_policy_tells_its_task_robot_rate_and_units() -> None:
    told = policy_metadata("TripodReach-v0")
    assert told["softsim_task"] == "TripodReach-v0"
    assert told["softsim_robot"] == "tripod"
    assert told["softsim_rate_hz"] == "25"
    assert '{"name": "effector position", "unit": "m", "size": 3}' in told["softsim_observation"]
    assert '{"joint": "servo_0", "unit": "rad", "low": -1.6, "high": -0.4}' in told["softsim_action"]
    with pytest.raises(PolicyError, match="TripodReach-v0"):
        policy_metadata("TripodDance-v0")


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"softsim_task": ""}, "does not tell its task"),
        ({"softsim_task": "TripodDance-v0"}, "TripodDance-v0"),
        ({"softsim_rate_hz": "50"}, "softsim_rate_hz is 50, and TripodReach-v0 of this version wants 25"),
        ({"softsim_robot": "emio"}, "softsim_robot is emio"),
        ({"softsim_observation": ""}, "softsim_observation is missing"),
        ({"inputs": 13}, r"its input is .* by 14"),
        ({"outputs": 2}, r"its output is .* by 3"),
    ],
)
def test_a_file_that_does_not_fit_is_refused(changes: dict[str, Any], sentence: str, tmp_path: Path) -> None:
    file = write_policy(tmp_path / "policy.onnx", "TripodReach-v0", **changes)
    with pytest.raises(PolicyError, match=sentence) as refused:
        load_policy(file)
    assert len(str(refused.value).splitlines()) == 1


def test_a_file_that_is_none_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match="cannot be read"):
        load_policy(tmp_path / "nowhere.onnx")
    for data in (b"", b"nothing of the kind", SHIPPED.read_bytes()[:200]):
        (tmp_path / "broken.onnx").write_bytes(data)
        with pytest.raises(PolicyError, match="no ONNX file"):
            load_policy(tmp_path / "broken.onnx")


def test_a_robot_that_does_not_fit_is_refused(tmp_path: Path) -> None:
    reach = load_policy(write_policy(tmp_path / "reach.onnx", "TripodReach-v0"))
    assert reach.check_robot(load_scene("tripod_mid")) == -1
    with pytest.raises(PolicyError, match=r"drives tripod with the joints servo_0 \[rad\].*; cable_gripper"):
        reach.check_robot(load_scene("cable_gripper"))
    narrow = load_scene("tripod", {"joints": [{"name": "servo_1", "limits": {"lower": -1.0, "upper": -0.5}}]})
    with pytest.raises(PolicyError, match=r"servo_1 from -1\.6 to -0\.4; tripod allows -1 to -0\.5"):
        reach.check_robot(narrow)
    balance = load_policy(write_policy(tmp_path / "balance.onnx", "TripodBalance-v0"))
    with pytest.raises(PolicyError, match="rigid body ball"):
        balance.check_robot(load_scene("tripod"))
    assert balance.check_robot(TASKS["TripodBalance-v0"].description()) == 1


def test_an_answer_that_is_not_finite_is_none(tmp_path: Path) -> None:
    policy = load_policy(write_policy(tmp_path / "nan.onnx", "TripodReach-v0", weight=np.nan))
    with pytest.raises(PolicyError, match="not finite; nothing was moved"):
        policy.actions(np.ones((1, 14), dtype=np.float32))


@pytest.mark.slow
def test_the_shipped_policy_reaches_its_goals() -> None:
    pytest.importorskip("gymnasium")
    from softsim_core.learning.environments import RobotVectorEnv

    policy = load_policy(SHIPPED)
    robots = RobotVectorEnv("TripodReach-v0", 20, autoreset_mode="Disabled")
    observations, info = robots.reset(seed=10_000)
    for _ in range(TASKS["TripodReach-v0"].horizon):
        observations, _, _, _, info = robots.step(policy.actions(observations))
    assert info["is_success"].mean() >= 0.8
    assert np.median(info["distance_m"]) < 0.002
