"""Many robots of softsim as the vectorised environment that Stable-Baselines3 trains on."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from stable_baselines3.common.vec_env import VecEnv

import softsim_core.lab.learning  # noqa: F401 (registers the ids)


class Robots(VecEnv):
    """See the module; the robots share one Batch, on one or several cores.

    Args:
        name: Id of the environment, such as "softsim/TripodReach-v0".
        count: How many robots.
        seed: Robot i begins with seed + i.
        options: Arguments of `gymnasium.make_vec`, such as workers and randomise.
    """

    def __init__(self, name: str, count: int, seed: int, **options: Any) -> None:
        self._robots = gymnasium.make_vec(name, num_envs=count, autoreset_mode="SameStep", **options)
        self._first_seed: int | None = seed
        self._actions: Any = None
        super().__init__(count, self._robots.single_observation_space, self._robots.single_action_space)

    def reset(self) -> Any:
        observations, _ = self._robots.reset(seed=self._first_seed)
        self._first_seed = None
        return observations

    def step_async(self, actions: Any) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[Any, Any, Any, list[dict[str, Any]]]:
        observations, rewards, terminated, truncated, told = self._robots.step(self._actions)
        ended = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for robot in np.flatnonzero(ended).tolist():
            last = told["final_info"]
            infos[robot] = {
                "terminal_observation": told["final_obs"][robot],
                "TimeLimit.truncated": bool(truncated[robot] & ~terminated[robot]),
                **{name: last[name][robot] for name in ("is_success", "distance_m") if name in last},
            }
        return observations, rewards.astype(np.float32), ended, infos

    def close(self) -> None:
        self._robots.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        value = getattr(self._robots, attr_name, None)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise AttributeError(f"robots of one batch have no attribute {attr_name} of their own")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        raise AttributeError(f"robots of one batch have no method {method_name} of their own")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False for _ in self._get_indices(indices)]
