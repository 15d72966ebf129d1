"""Bytes that Python holds while copies are reset: `traced_resets.py N` prints them after each sixth of N."""

from __future__ import annotations

import gc
import json
import sys
import tracemalloc

import numpy as np

from softsim_core import Batch, load_scene


def main(resets: int) -> list[int]:
    batch = Batch(load_scene("tripod_ball"), 2)

    def episodes(count: int) -> None:
        for k in range(count):
            batch.command(np.full((1, 3), -1.0), [k % 2])
            batch.step(1, [k % 2])
            batch.reset([k % 2])

    def traced() -> int:
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    episodes(1000)  # NumPy keeps small arrays for later, of each size up to a number
    held = [traced()]
    for _ in range(6):
        episodes(resets // 6)
        held.append(traced())
    return held


if __name__ == "__main__":
    print(json.dumps(main(int(sys.argv[1]))))
