"""Success of a policy, and of the inverse controller, on the same seeded episodes of TripodReach.

    python examples/learning/evaluate_tripod_reach.py --randomise examples/learning/material.yaml

Each episode draws a goal, and with --randomise material, mass and latency. The inverse controller has the
model of the robot's file, hears the measured position, and makes four ticks in the time of an action.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from softsim_core import InverseController, Pose, load_policy
from softsim_core.lab.learning import REACHED_M, RobotEnv

TASK = "TripodReach-v0"
HERE = Path(__file__).parent

Act = Callable[[Any], Any]
"""From an observation to an action from -1 to 1."""


def by_policy(file: Path) -> Callable[[Any], Act]:
    policy = load_policy(file)
    return lambda _: lambda observation: policy.actions(observation[None])[0]


def by_inverse(task: Any) -> Callable[[Any], Act]:
    controller = InverseController(task.description())
    middle, half = 0.5 * np.add(task.high, task.low), 0.5 * np.subtract(task.high, task.low)
    upright = np.array([0.0, 0.0, 0.0, 1.0])

    def begin(observation: Any) -> Act:
        controller.start(observation[8:11].astype(float))
        controller.set_goal(Pose(observation[11:14].astype(float), upright))

        def act(observation: Any) -> Any:
            measured = Pose(observation[3:6].astype(float), np.full(4, np.nan))
            for _ in range(task.steps):
                report = controller.tick(measured)
            return ((report.command - middle) / half).astype(np.float32)

        return act

    return begin


def distances(environment: RobotEnv, begin: Callable[[Any], Act], episodes: int, first: int) -> Any:
    """Of each episode the distance from the goal at its end in [m]."""
    found = np.zeros(episodes)
    for number in range(episodes):
        observation, _ = environment.reset(seed=first + number)
        act, ended = begin(observation), False
        while not ended:
            observation, _, terminated, truncated, info = environment.step(act(observation))
            ended = terminated or truncated
        found[number] = info["distance_m"]
        if (number + 1) % 50 == 0:
            share = np.mean(found[: number + 1] < REACHED_M)
            print(f"{number + 1} episodes: {share:.3f} within 2 mm", file=sys.stderr, flush=True)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("--policy", type=Path, default=HERE / "tripod_reach.onnx")
    parser.add_argument("--randomise", help="file of what differs from episode to episode")
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=10_000, help="of the first episode")
    parser.add_argument("--only", choices=("policy", "inverse"))
    chosen = parser.parse_args()
    environment = RobotEnv(TASK, randomise=chosen.randomise)
    drivers = {"policy": by_policy, "inverse": lambda _: by_inverse(environment.episodes.task)}
    for name in [chosen.only] if chosen.only else drivers:
        found = 1e3 * distances(environment, drivers[name](chosen.policy), chosen.episodes, chosen.seed)
        told = {
            "driver": name,
            "episodes": len(found),
            "within_2_mm": round(float(np.mean(found < 2.0)), 4),
            **{f"distance_mm_{q}": round(float(np.percentile(found, q)), 2) for q in (50, 90, 99)},
        }
        print(json.dumps(told), flush=True)


if __name__ == "__main__":
    main()
