"""Policies as ONNX files: the same actions wherever an observation comes from, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("onnxruntime")
pytest.importorskip("numba")
onnx = pytest.importorskip("onnx")

from policy_files import constant, write_endless_policy, write_graph, write_policy  # noqa: E402

from softsim_core import load_scene  # noqa: E402
from softsim_core.base import PolicyError  # noqa: E402
from softsim_core.lab.learning import (  # noqa: E402
    TASKS,
    Moment,
    Senses,
    load_policy,
    objection,
    policy_metadata,
)

SHIPPED = Path(__file__).parents[2] / "examples" / "learning" / "tripod_reach.onnx"
PERFECT = dict.fromkeys(
    ("command_latency", "command_noise", "joint_step", "position_noise", "tilt_noise", "force_noise"), 0.0
) | {"rate_noise": 0.0, "joint_noise": 0.0, "effort_noise": 0.0}


@pytest.mark.parametrize("name", TASKS)
def test_senses_of_a_robot_give_the_commands_of_the_environment(name: str, tmp_path: Path) -> None:
    pytest.importorskip("gymnasium")
    from softsim_core.lab.learning import RobotEnv

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
        ({"softsim_task": ""}, "does not name its task"),
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


WEIGHTS = np.zeros((14, 3), np.float32)


def test_an_endless_policy_is_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("softsim_core.lab.learning.policy.LONGEST_ACTION_S", 0.1)
    policy = load_policy(write_endless_policy(tmp_path / "endless.onnx", "TripodReach-v0"))
    with pytest.raises(PolicyError, match=r"has not answered within 0\.1 s; nothing was moved"):
        policy.actions(np.zeros((1, 14), np.float32))


def test_a_policy_that_asks_for_six_gigabytes_gets_none(tmp_path: Path) -> None:
    helper = onnx.helper
    nodes = [
        helper.make_node("ConstantOfShape", ["size"], ["huge"]),
        helper.make_node("ReduceMax", ["huge"], ["zero"], keepdims=0),
        helper.make_node("MatMul", ["observation", "weights"], ["product"]),
        helper.make_node("Add", ["product", "zero"], ["action"]),
    ]
    constants = [constant("size", [1_500_000_000]), constant("weights", WEIGHTS)]
    policy = load_policy(write_graph(tmp_path / "huge.onnx", "TripodReach-v0", nodes, constants))
    with pytest.raises(PolicyError, match=r"it cannot answer .*ConstantOfShape"):
        policy.actions(np.zeros((1, 14), np.float32))


def huge_constant() -> Any:
    made = constant("weights", WEIGHTS)
    made.dims[:] = [1_500_000_000, 3]
    return made


def huge_sparse_constant() -> Any:
    values, places = constant("weights", np.float32([1.0])), constant("", np.int64([0]))
    return onnx.helper.make_sparse_tensor(values, places, [1_500_000_000, 3])


def other_files() -> Any:
    made = constant("weights", WEIGHTS)
    made.ClearField("raw_data")
    made.data_location = onnx.TensorProto.EXTERNAL
    made.external_data.add(key="location", value="passwords")
    return made


@pytest.mark.parametrize("place", ["initializer", "attribute", "branch"])
@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (huge_constant, r"its constants take 18000\d+ bytes or more; at most 268435456 are allowed"),
        (huge_sparse_constant, r"its constants take 36000\d+ bytes or more"),
        (other_files, r"it keeps constants in other files \(external data\); save it as one file"),
    ],
)
def test_what_a_file_asks_for_is_seen_before_it_is_loaded(
    make: Any, sentence: str, place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("onnxruntime.InferenceSession", None)
    helper, value = onnx.helper, make()
    sparse = isinstance(value, onnx.SparseTensorProto)
    model = onnx.load(write_policy(tmp_path / "policy.onnx", "TripodReach-v0"))
    held = helper.make_node("Constant", [], ["held"], **{"sparse_value" if sparse else "value": value})
    if place == "initializer":
        (model.graph.sparse_initializer if sparse else model.graph.initializer).append(value)
    elif place == "attribute":
        model.graph.node.append(held)
    else:
        branch = helper.make_graph([held], "branch", [], [])
        model.graph.node.append(
            helper.make_node("If", ["yes"], ["b"], then_branch=branch, else_branch=branch)
        )
    file = tmp_path / "asks.onnx"
    file.write_bytes(model.SerializeToString())
    with pytest.raises(PolicyError, match=sentence):
        load_policy(file)


def test_functions_and_damaged_files_are_refused(tmp_path: Path) -> None:
    function = onnx.helper.make_function("own", "f", ["a"], ["b"], [], [onnx.helper.make_opsetid("", 17)])
    file = write_graph(tmp_path / "policy.onnx", "TripodReach-v0", [], [], functions=[function])
    with pytest.raises(PolicyError, match="it defines functions of its own"):
        load_policy(file)
    whole = write_policy(tmp_path / "policy.onnx", "TripodReach-v0").read_bytes()
    random = np.random.default_rng(5)
    for _ in range(200):
        data = bytearray(whole[: random.integers(1, len(whole) + 1)])
        data[random.integers(len(data))] ^= 1 << random.integers(8)
        objection(bytes(data), 1 << 20)  # never raises


@pytest.mark.slow
def test_the_shipped_policy_reaches_its_goals() -> None:
    pytest.importorskip("gymnasium")
    from softsim_core.lab.learning import RobotVectorEnv

    policy = load_policy(SHIPPED)
    robots = RobotVectorEnv("TripodReach-v0", 20, autoreset_mode="Disabled")
    observations, info = robots.reset(seed=10_000)
    for _ in range(TASKS["TripodReach-v0"].horizon):
        observations, _, _, _, info = robots.step(policy.actions(observations))
    assert info["is_success"].mean() >= 0.8
    assert np.median(info["distance_m"]) < 0.002
