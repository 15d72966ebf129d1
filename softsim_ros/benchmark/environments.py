"""What the environments for training cost beside the physics that they run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from time import perf_counter

import numpy as np

from softsim_ros.benchmark.report import aligned
from softsim_ros.benchmark.timing import no_garbage_collection

LIMIT = 0.10
"""Share of the time that may be spent outside the physics at 64 copies."""
ACTIONS = 5
"""Of a turn."""


@dataclass(frozen=True)
class EnvironmentCost:
    """One environment with some robots.

    Attributes:
        environment: Its id.
        copies: How many robots.
        rate: Actions of all of them per second, the best turn.
        overhead: Share of that turn's time outside Batch.step, [-].
    """

    environment: str
    copies: int
    rate: float
    overhead: float

    @property
    def missed(self) -> bool:
        """Whether it is more than asked."""
        return self.overhead >= LIMIT

    @property
    def sentence(self) -> str:
        """What is missed."""
        return f"{self.environment}: {100.0 * self.overhead:.1f} % outside the physics, target < {LIMIT:.0%}"

    def as_json(self) -> dict[str, object]:
        """As a JSON object."""
        return asdict(self)


def measure_environments(copies: int, rounds: int) -> list[EnvironmentCost]:
    """Measure all environments with that many robots on one core.

    Raises:
        ImportError: Gymnasium is not installed.
    """
    from softsim_core.learning.environments import RobotVectorEnv
    from softsim_core.learning.tasks import TASKS

    costs = []
    for name in TASKS:
        robots = RobotVectorEnv(name, copies)
        batch, spent = robots.episodes.batch, [0.0]
        physics = batch.step

        def timed(steps: int = 1, chosen: Sequence[int] | None = None) -> list[int]:
            started = perf_counter()
            failed = physics(steps, chosen)  # noqa: B023 (called within this turn of the loop only)
            spent[0] += perf_counter() - started  # noqa: B023
            return failed

        batch.step = timed  # type: ignore[method-assign, assignment]
        robots.reset(seed=0)
        still = np.zeros(robots.action_space.shape or (), dtype=np.float32)
        best, share = 0.0, 1.0
        with no_garbage_collection():
            for _ in range(rounds):
                spent[0], started = 0.0, perf_counter()
                for _ in range(ACTIONS):
                    robots.step(still)
                taken = perf_counter() - started
                if copies * ACTIONS / taken > best:
                    best, share = copies * ACTIONS / taken, 1.0 - spent[0] / taken
        costs.append(EnvironmentCost(f"softsim/{name}", copies, best, share))
        robots.close()
    return costs


def cost_table(costs: Sequence[EnvironmentCost]) -> list[str]:
    """The costs as lines of aligned columns, head first."""
    rows = [
        (each.environment, str(each.copies), f"{each.rate:.0f}", f"{100.0 * each.overhead:.1f} %")
        for each in costs
    ]
    return aligned([("environment", "copies", "actions/s", "overhead"), *rows])
