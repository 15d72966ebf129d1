"""Memory of randomised episodes: `randomised_episodes.py FILE N` prints resident megabytes eleven times."""

from __future__ import annotations

import gc
import json
import sys
from pathlib import Path

import numpy as np

from softsim_core.lab.learning import RobotVectorEnv

COPIES = 4


def resident_mb() -> float:
    """Resident memory of this process in [MB]."""
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if "VmRSS" in line)
    return float(line.split()[1]) * 1024 / 1e6


def main(randomisation: Path, episodes: int) -> None:
    robots = RobotVectorEnv("TripodReach-v0", COPIES, randomise=randomisation)
    robots.reset(seed=1)
    every = max(episodes // COPIES // 10, 1)
    actions = np.full(robots.action_space.shape, 0.5, dtype=np.float32)
    for number in range(episodes // COPIES + 1):
        if number % every == 0:
            gc.collect()
            print(json.dumps([number * COPIES, round(resident_mb(), 2)]), flush=True)
        robots.reset()
        robots.step(actions)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
