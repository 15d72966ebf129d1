"""Gymnasium ids of the environments."""

from __future__ import annotations

import gymnasium

from softsim_core.lab.learning.tasks import TASKS

_HOME = "softsim_core.lab.learning.environments"


def register_environments() -> None:
    """Register the ids of the environments with Gymnasium."""
    for name, task in TASKS.items():
        if f"softsim/{name}" not in gymnasium.registry:
            gymnasium.register(
                id=f"softsim/{name}",
                entry_point=f"{_HOME}:RobotEnv",
                vector_entry_point=f"{_HOME}:RobotVectorEnv",
                kwargs={"name": name},
                max_episode_steps=task.horizon,
            )
