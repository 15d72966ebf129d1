"""The environments keep Gymnasium's rules, and give the same episodes alone, together, and again."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import warnings
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium")
pytest.importorskip("numba")

from softsim_core import CommandError, SceneError  # noqa: E402
from softsim_core.base import Array  # noqa: E402
from softsim_core.lab.learning import (  # noqa: E402
    TASKS,
    RobotEnv,
    RobotVectorEnv,
)

NAMES = tuple(TASKS)
FOLDER = Path(__file__).parent


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_gymnasium_accepts_them(name: str) -> None:
    from gymnasium.utils.env_checker import check_env

    environment = gymnasium.make(f"softsim/{name}", render_mode="rgb_array")
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        check_env(environment.unwrapped)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_stable_baselines_accepts_them(name: str) -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        checker.check_env(RobotEnv(name))


def run(environment: RobotEnv, seed: int, actions: Array) -> tuple[list[bytes], list[float]]:
    """Observations and rewards of actions (s, j); the one after the end of an episode begins another."""
    seen, rewards, ended = [environment.reset(seed=seed)[0].tobytes()], [], False
    for action in actions:
        if ended:
            observation, reward, ended = environment.reset()[0], 0.0, False
        else:
            observation, reward, terminated, truncated, _ = environment.step(action)
            ended = terminated or truncated
        seen.append(observation.tobytes())
        rewards.append(reward)
    return seen, rewards


def actions_for(name: str, copies: int, count: int) -> Array:
    """Random, of the gripper such that it goes down and closes, shape (count, copies, j)."""
    random = np.random.default_rng(5)
    actions = random.uniform(-1.0, 1.0, (count, copies, len(TASKS[name].low)))
    if name.startswith("Cable"):
        actions[:, :, :3] = np.where(
            np.arange(count)[:, None, None] < 25, -1.0, 0.3 + 0.1 * actions[:, :, :3]
        )
        actions[:, :, 3] = -0.92
    else:
        actions *= 0.3
    return actions.astype(np.float32)


def same_episodes(name: str, workers: int, count: int) -> bool:
    """Whether robots together, and one after an episode of its own, do what fresh ones do alone."""
    actions = actions_for(name, 2, count)
    alone = []
    for copy in range(2):
        environment = RobotEnv(name)
        alone.append(run(environment, 7 + copy, actions[:, copy]))
        again = run(environment, 7 + copy, actions[:, copy])
        if again != alone[-1]:
            return False
    together = RobotVectorEnv(name, 2, workers)
    together.reset(seed=3)
    together.step(actions[0])
    seen = [[row.tobytes()] for row in together.reset(seed=7)[0]]
    rewards: list[list[float]] = [[], []]
    for rows in actions:
        observations, reward, *_ = together.step(rows)
        for copy in range(2):
            seen[copy].append(observations[copy].tobytes())
            rewards[copy].append(float(reward[copy]))
    together.close()
    return all((seen[copy], rewards[copy]) == alone[copy] for copy in range(2))


def same_elsewhere(name: str, workers: int, count: int) -> bool:
    """`same_episodes` in a process that loads compiled kernels, and has not just compiled them."""
    script = f"import sys; sys.path.insert(0, {str(FOLDER)!r}); import test_environments as t; "
    code = f"{script}sys.exit(not t.same_episodes({name!r}, {workers}, {count}))"
    paths = os.pathsep.join([str(FOLDER.parents[1]), *filter(None, sys.path)])
    environment = {**os.environ, "PYTHONPATH": paths}
    return (
        subprocess.run([sys.executable, "-c", code], env=environment, timeout=580, check=False).returncode
        == 0
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_the_same_seed_gives_the_same_episode_alone_and_together(name: str) -> None:
    assert same_episodes(name, 1, 40)


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("workers", [1, 2])
def test_it_does_so_over_1000_steps(name: str, workers: int) -> None:
    assert same_elsewhere(name, workers, -(-1000 // TASKS[name].steps))


@pytest.mark.slow
def test_two_workers_do_the_same() -> None:
    assert same_elsewhere("TripodReach-v0", 2, 10)


@pytest.mark.slow
def test_a_scripted_gripper_lifts_the_cube() -> None:
    environment = RobotEnv("CableGripperLift-v0")
    task = environment.episodes.task
    middle, half = 0.5 * np.add(task.high, task.low), 0.5 * np.subtract(task.high, task.low)
    environment.reset(seed=0)
    info: dict[str, Any] = {}
    rewards = []
    for k in range(task.horizon):
        pull, height = 0.013 if k >= 24 else 0.0, -0.05 * min(1.0, max(0.0, 1.0 - (k - 50) / 25))
        command = np.array([pull, pull, pull, height if k >= 50 else -0.05, 0.0])
        _, reward, _, truncated, info = environment.step(((command - middle) / half).astype(np.float32))
        rewards.append(reward)
    assert truncated
    assert info["is_success"]
    assert info["cube_height_m"] == pytest.approx(0.0556, abs=2e-3)
    assert np.all(info["tensions_n"] > 1.0)
    assert rewards[0] < 0.2 < 1.0 < rewards[-1]


def test_a_ball_that_leaves_the_plate_ends_the_episode() -> None:
    environment = RobotEnv("TripodBalance-v0")
    environment.reset(seed=1)
    for _ in range(150):
        *_, terminated, truncated, info = environment.step(np.array([1.0, -1.0, -1.0], dtype=np.float32))
        if terminated:
            break
    assert terminated
    assert not truncated
    assert info["ball_distance_m"] > 0.03


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
def test_episodes_begin_anew_as_the_mode_says(mode: str) -> None:
    robots = gymnasium.make_vec("softsim/TripodReach-v0", num_envs=2, autoreset_mode=mode)
    horizon, still = TASKS["TripodReach-v0"].horizon, np.zeros((2, 3), dtype=np.float32)
    _, begun = robots.reset(seed=0)
    robots.step(still)
    if mode == "Disabled":
        robots.reset(options={"reset_mask": np.array([True, False])})
    for _ in range(horizon - 2):
        _, _, terminated, truncated, _ = robots.step(still)
        assert not (terminated | truncated).any()
    last, _, terminated, truncated, info = robots.step(still)
    assert truncated.tolist() == ([False, True] if mode == "Disabled" else [True, True])
    assert not terminated.any()
    if mode == "SameStep":
        assert info["_final_obs"].all()
        assert not np.array_equal(info["final_obs"], last)
        assert info["final_info"]["time_s"].tolist() == pytest.approx([2.0, 2.0])
        assert info["time_s"].tolist() == [0.0, 0.0]
    elif mode == "NextStep":
        _, reward, _, truncated, info = robots.step(still)
        assert reward.tolist() == [0.0, 0.0]
        assert not truncated.any()
        assert info["time_s"].tolist() == [0.0, 0.0]
        assert not np.array_equal(info["goal_m"], begun["goal_m"])
    else:
        with pytest.raises(gymnasium.error.ResetNeeded, match=r"\[1\]"):
            robots.step(still)
    robots.close()


@pytest.mark.slow
def test_pictures_show_the_robot() -> None:
    pytest.importorskip("matplotlib")
    robots = RobotVectorEnv("TripodBalance-v0", 2, render_mode="rgb_array")
    robots.reset(seed=0)
    pictures = robots.render()
    assert pictures is not None
    for picture in pictures:
        assert picture.shape == (400, 400, 3)
        red = (picture[..., 0] > 120) & (picture[..., 1] < 80) & (picture[..., 2] < 80)
        assert 100 < red.sum() < 5000  # the ball
    assert not np.array_equal(*pictures)


@pytest.mark.slow
def test_an_id_with_its_module_needs_no_import() -> None:
    code = (
        "import gymnasium; print(gymnasium.make('softsim_core.lab.learning:softsim/TripodReach-v0').spec.id)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=True
    )
    assert done.stdout.split() == ["softsim/TripodReach-v0"]


def last_action(environment: Any, most: int) -> int:
    """After how many actions the first episode is truncated, or `most`."""
    environment.reset(seed=0)
    for count in range(1, most + 1):
        _, _, terminated, truncated, _ = environment.step(environment.action_space.sample() * 0.0)
        assert not np.any(terminated)
        if np.any(truncated):
            return count
    return most


@pytest.mark.parametrize("asked", [20, 60])
def test_an_episode_is_as_long_as_asked_for(asked: int) -> None:
    one = gymnasium.make("softsim/TripodReach-v0", max_episode_steps=asked)
    many = gymnasium.make_vec("softsim/TripodReach-v0", num_envs=2, max_episode_steps=asked)
    assert last_action(one, 70) == last_action(many, 70) == asked
    assert last_action(RobotEnv("TripodReach-v0", max_episode_steps=asked), 70) == asked


def test_an_episode_is_as_long_as_the_task_says() -> None:
    assert last_action(gymnasium.make("softsim/TripodReach-v0"), 70) == 50
    assert last_action(RobotEnv("TripodReach-v0"), 70) == 50
    with pytest.raises(SceneError, match="max_episode_steps 0: give 1 or more"):
        RobotEnv("TripodReach-v0", max_episode_steps=0)


def test_a_video_plays_at_the_pace_of_the_robot() -> None:
    rates = [gymnasium.make(f"softsim/{name}").metadata["render_fps"] for name in NAMES]
    assert rates == [25, 50, 20]


@pytest.mark.parametrize("copied", [deepcopy, lambda each: pickle.loads(pickle.dumps(each))])
@pytest.mark.parametrize("randomise", [None, "material.yaml"])
def test_a_copy_goes_on_from_the_same_state(copied: Any, randomise: str | None) -> None:
    file = None if randomise is None else str(FOLDER.parents[1] / "examples" / "learning" / randomise)
    made: list[Any] = [
        gymnasium.make("softsim/TripodReach-v0", randomise=file),
        RobotVectorEnv("TripodReach-v0", 2, randomise=file),
    ]
    for one in made:
        one.reset(seed=3)
        action = np.full(one.action_space.shape, 0.3, dtype=np.float32)
        one.step(action)
        other = copied(one)
        told = [each.step(action)[0].tobytes() for _ in range(3) for each in (one, other)]
        assert told[::2] == told[1::2]
        assert one.reset()[0].tobytes() == other.reset()[0].tobytes()


def test_the_full_state_comes_only_when_asked_for() -> None:
    asked = RobotEnv("TripodReach-v0", full_state=True)
    observation, _ = asked.reset(seed=0)
    assert observation.shape == asked.episodes.batch.states[0].shape
    assert RobotEnv("TripodReach-v0").observation_space.shape == (14,)


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(SceneError, match="TripodReach-v0"):
        RobotEnv("TripodDance-v0")
    with pytest.raises(SceneError, match="rgb_array"):
        RobotEnv("TripodReach-v0", render_mode="ansi")
    with pytest.raises(SceneError, match="command_latency"):
        RobotEnv("TripodReach-v0", devices={"delay": 0.1})


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_an_action_that_is_not_finite_is_refused_at_that_step(bad: float) -> None:
    """Also where servos get it one action later; nothing has moved, and the episode goes on."""
    late = {"command_latency": 0.04}
    good, wrong = np.full(3, 0.2, np.float32), np.float32([0.1, bad, 0.1])
    told, untold = (RobotEnv("TripodReach-v0", devices=late) for _ in range(2))
    for environment in (told, untold):
        environment.reset(seed=5)
        environment.step(good)
    for _ in range(2):
        with pytest.raises(CommandError, match=r"actions of robots \[0\] refused: one is not finite"):
            told.step(wrong)
    for _ in range(3):
        assert told.step(good)[0].tobytes() == untold.step(good)[0].tobytes()


def test_of_many_robots_all_are_told_or_none() -> None:
    robots = RobotVectorEnv("TripodReach-v0", num_envs=3)
    robots.reset(seed=5)
    before = robots.episodes.batch.states.copy()
    actions = np.zeros((3, 3), np.float32)
    actions[1, 2] = np.nan
    with pytest.raises(CommandError, match=r"actions of robots \[1\] refused"):
        robots.step(actions)
    assert robots.episodes.batch.states.tobytes() == before.tobytes()
    with pytest.raises(CommandError, match="commands of a batch refused"):
        robots.episodes.batch.command(actions)
    assert robots.episodes.batch.states.tobytes() == before.tobytes()
