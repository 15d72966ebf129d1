"""Gymnasium environments of the tasks: episodes in all copies of a batch, one robot or many."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from os import PathLike
from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from softsim_core.base import BoolArray, IndexArray, SceneError, listing
from softsim_core.lab.learning.episodes import Episodes
from softsim_core.lab.learning.picture import Painter
from softsim_core.lab.learning.randomisation import Devices, load_randomisation
from softsim_core.lab.learning.tasks import TASKS, Numbers

_MODES = ("rgb_array", "human")
_ZERO = np.zeros(1, dtype=np.int64)


def _episodes(
    name: str,
    copies: int,
    workers: int,
    *,
    randomise: str | PathLike[str] | None = None,
    devices: Mapping[str, float] | None = None,
    full_state: bool = False,
    max_episode_steps: int | None = None,
) -> Episodes:
    if name not in TASKS:
        raise SceneError(f"unknown task {name!r}; known: {listing(TASKS)}")
    task = TASKS[name]
    chosen: Devices | None = None if devices is None else task.devices.with_values(devices)
    drawn = None if randomise is None else load_randomisation(str(randomise))
    if max_episode_steps is not None and max_episode_steps < 1:
        raise SceneError(f"max_episode_steps {max_episode_steps}: give 1 or more")
    episodes = Episodes(task, copies, workers, chosen, drawn, full_state)
    episodes.horizon = max_episode_steps or task.horizon
    return episodes


def _spaces(episodes: Episodes) -> tuple[Any, Any]:
    low, high = episodes.bounds()
    size = len(episodes.task.low)
    return (
        gymnasium.spaces.Box(low, high, dtype=np.float32),
        gymnasium.spaces.Box(-1.0, 1.0, (size,), dtype=np.float32),
    )


def _mode(mode: str | None) -> str | None:
    if mode is not None and mode not in _MODES:
        raise SceneError(f"render_mode {mode!r} is not known; known: {listing(_MODES)}, or none")
    return mode


def _metadata(episodes: Episodes) -> dict[str, Any]:
    """Return Gymnasium metadata with one picture per action, so that a video plays at the robot's pace."""
    return {"render_modes": list(_MODES), "render_fps": round(1.0 / episodes.span)}


class _Copyable:
    """Common part of both environments: copies by `deepcopy` or `pickle`, and pictures."""

    render_mode: str | None
    episodes: Episodes
    _arguments: dict[str, Any]
    _painter: Painter | None

    def __reduce__(self) -> tuple[Any, ...]:
        # created with the same arguments, then given the state that these do not determine
        state = {name: value for name, value in vars(self).items() if name not in ("episodes", "_painter")}
        return partial(type(self), **self._arguments), (), {**state, "episodes": self.episodes.save_state()}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        self.episodes.restore(state["episodes"])
        vars(self).update({name: value for name, value in state.items() if name != "episodes"})

    def _drawing(self) -> Painter:
        if self._painter is None:
            self._painter = Painter(self.episodes.task, self.episodes.batch)
        return self._painter

    def _show(self) -> None:
        if self.render_mode == "human":
            self._drawing().show(0)

    def _end(self) -> None:
        """Close the window and stop the simulation processes."""
        if self._painter is not None:
            self._painter.close()
        self.episodes.close()


class RobotEnv(_Copyable, gymnasium.Env[Any, Any]):
    """A robot and its task; docs/learning.md describes actions and observations, `info` has SI units.

    A copy, by `deepcopy` or `pickle`, continues independently from the same state.

    Args:
        name: The task, such as "TripodReach-v0".
        render_mode: "rgb_array", "human" or None.
        randomise: File of the variations between episodes, see RandomisationDescription.
        devices: Fields of Devices that differ from the task's.
        full_state: Whether an observation is the whole state (State.buffer), without noise.
        max_episode_steps: Actions of an episode; None: the task's. `gymnasium.make` counts them itself.

    Raises:
        SceneError, ConfigError: an argument is invalid.
    """

    metadata = {"render_modes": list(_MODES)}  # noqa: RUF012 (Gymnasium's own form)

    def __init__(
        self,
        name: str,
        render_mode: str | None = None,
        randomise: str | PathLike[str] | None = None,
        devices: Mapping[str, float] | None = None,
        full_state: bool = False,
        max_episode_steps: int | None = None,
    ) -> None:
        episodes: dict[str, Any] = {
            "randomise": randomise,
            "devices": devices,
            "full_state": full_state,
            "max_episode_steps": max_episode_steps,
        }
        self._arguments: dict[str, Any] = {"name": name, "render_mode": render_mode, **episodes}
        self.render_mode = _mode(render_mode)
        self.episodes = _episodes(name, 1, 1, **episodes)
        self.metadata = _metadata(self.episodes)
        self.observation_space, self.action_space = _spaces(self.episodes)
        self._painter: Painter | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Numbers, dict[str, Any]]:
        """Start an episode; see gymnasium.Env."""
        super().reset(seed=seed)
        self.episodes.generators[0] = self.np_random
        observation = self.episodes.begin(_ZERO)
        self._show()
        return observation[0], self._info(self.episodes.describe_start(_ZERO))

    def step(self, action: Numbers) -> tuple[Numbers, float, bool, bool, dict[str, Any]]:
        """Perform an action; see gymnasium.Env.

        Raises:
            ArrayError, CommandError: not one finite number for each joint; nothing was moved.
        """
        observations, done = self.episodes.act(_ZERO, np.asarray(action)[None])
        self._show()
        return (
            observations[0],
            float(done.reward[0]),
            bool(done.terminated[0]),
            bool(done.truncated[0]) and self.spec is None,  # else a wrapper of gymnasium.make counts actions
            self._info(done.info),
        )

    def render(self) -> NDArray[np.uint8] | None:  # type: ignore[override]
        """Return a picture of the present state, or None where a window shows it; see gymnasium.Env."""
        self._show()
        return self._drawing().paint(0) if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Close the window and stop the simulation processes."""
        self._end()

    def _info(self, observations: Mapping[str, Numbers]) -> dict[str, Any]:
        info = {name: row[0].item() if row.ndim == 1 else row[0].copy() for name, row in observations.items()}
        return {**info, **self.episodes.parameters(0)}


class RobotVectorEnv(_Copyable, VectorEnv[Any, Any, Any]):
    """Many robots with the same task in one Batch. Copy i with seed s does the same as one robot with s + i.

    Args:
        name: The task.
        num_envs: Number of robots.
        workers: Number of cores, see Batch.
        autoreset_mode: Gymnasium's: next step (the default), same step, or disabled.
        render_mode: "rgb_array" (`render` returns a picture of each), "human" (the first one) or None.
        episodes: randomise, devices, full_state and max_episode_steps, see RobotEnv.

    Raises:
        SceneError, ConfigError, BatchError: an argument is invalid.
    """

    def __init__(
        self,
        name: str,
        num_envs: int = 1,
        workers: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **episodes: Any,
    ) -> None:
        self._arguments: dict[str, Any] = {
            "name": name,
            "num_envs": num_envs,
            "workers": workers,
            "autoreset_mode": autoreset_mode,
            "render_mode": render_mode,
            **episodes,
        }
        self.num_envs, self.render_mode = num_envs, _mode(render_mode)
        self._autoreset = AutoresetMode(autoreset_mode)
        self.episodes = _episodes(name, num_envs, workers, **episodes)
        self.metadata = {**_metadata(self.episodes), "autoreset_mode": self._autoreset}
        self.single_observation_space, self.single_action_space = _spaces(self.episodes)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._all = np.arange(num_envs)
        self._ended: BoolArray = np.zeros(num_envs, dtype=np.bool_)
        shape = (num_envs, len(self.episodes.bounds()[0]))
        self._observations: Numbers = np.zeros(shape, dtype=np.float32)
        self._seeded = False
        self._painter: Painter | None = None

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Numbers, dict[str, Any]]:
        """Start an episode in all robots, or in those of options["reset_mask"]; see VectorEnv."""
        if seed is None and not self._seeded:
            seed = int(np.random.SeedSequence().generate_state(1)[0])
        seeds: list[int | None] = [None] * self.num_envs
        if seed is not None:
            seeds = [seed + k for k in range(self.num_envs)] if isinstance(seed, int) else seed
        self._seeded = True
        mask = np.ones(self.num_envs, dtype=np.bool_)
        if options is not None and "reset_mask" in options:
            mask = np.asarray(options["reset_mask"], dtype=np.bool_)
        numbers = np.flatnonzero(mask)
        for number in numbers.tolist():
            if seeds[number] is not None:
                self.episodes.generators[number] = seeding.np_random(seeds[number])[0]
        self._observations[numbers] = self.episodes.begin(numbers)
        self._ended[numbers] = False
        self._show()
        return self._observations.copy(), self._info(self.episodes.describe_start(numbers), numbers)

    def step(self, actions: Numbers) -> tuple[Numbers, Numbers, BoolArray, BoolArray, dict[str, Any]]:
        """Perform an action in every robot; see VectorEnv.

        Raises:
            ResetNeeded: autoreset is disabled, and a robot's episode has ended.
            ArrayError, CommandError: not one finite number for each joint of a robot with a running episode;
                nothing was moved, and no episode was started.
        """
        reward, terminated, truncated = np.zeros(self.num_envs), self._none(), self._none()
        anew = np.flatnonzero(self._ended)
        if len(anew) and self._autoreset == AutoresetMode.DISABLED:
            raise gymnasium.error.ResetNeeded(
                f"the episodes of robots {anew.tolist()} have ended: reset(options={{'reset_mask': ...}})"
            )
        going = self._all if not len(anew) else np.flatnonzero(~self._ended)
        self.episodes.check_actions(going, np.asarray(actions)[going])
        info: dict[str, Any] = {}
        if len(anew):
            self._observations[anew] = self.episodes.begin(anew)
            info = self._info(self.episodes.describe_start(anew), anew)
        if len(going):
            found, done = self.episodes.act(going, np.asarray(actions)[going])
            self._observations[going] = found
            reward[going], terminated[going], truncated[going] = done[:3]
            info = self._info(done.info, going, info)
        self._ended = terminated | truncated
        if self._autoreset == AutoresetMode.SAME_STEP and self._ended.any():
            info = self._begin_again(info)
        self._show()
        return self._observations.copy(), reward, terminated, truncated, info

    def _begin_again(self, info: dict[str, Any]) -> dict[str, Any]:
        """Restart ended episodes within the step; store their end in final_obs and final_info."""
        ended, mask = np.flatnonzero(self._ended), self._ended.copy()
        final = {name: value.copy() for name, value in info.items()}
        for name in [name for name in final if name.startswith("_")]:
            final[name] &= mask
        last = self._observations.copy()
        self._observations[ended] = self.episodes.begin(ended)
        info = self._info(self.episodes.describe_start(ended), ended, info)
        self._ended = self._none()
        return {**info, "final_obs": last, "_final_obs": mask, "final_info": final, "_final_info": mask}

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Return one picture per robot, or None where a window shows the first; see VectorEnv."""
        if self.render_mode != "rgb_array":
            return None
        return tuple(self._drawing().paint(number) for number in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Close the window and stop the simulation processes; gymnasium calls this method from `close`."""
        self._end()

    def _none(self) -> BoolArray:
        return np.zeros(self.num_envs, dtype=np.bool_)

    def _info(
        self, observations: Mapping[str, Numbers], numbers: IndexArray, info: dict[str, Any] | None = None
    ) -> dict[str, Any]:
        """Return info in Gymnasium's form: an array over all robots by name, under `_name` its mask."""
        info = {} if info is None else info
        drawn = [self.episodes.parameters(number) for number in numbers.tolist()]
        for name in drawn[0] if drawn else ():
            observations = {**observations, name: np.array([each[name] for each in drawn])}
        for name, rows in observations.items():
            if name not in info:
                info[name] = np.zeros((self.num_envs, *rows.shape[1:]), dtype=rows.dtype)
                info[f"_{name}"] = self._none()
            info[name][numbers], info[f"_{name}"][numbers] = rows, True
        return info
