"""Random numbers of samples: each has its own, whatever was drawn before it.

A counter-based generator (Philox) with a key from a sensor's seed and name and a counter from the sample's
number. So noise depends on no other sensor, is the same again after a reset, and goes on in the same way from
a snapshot, without any state of its own.

Source: Salmon et al. 2011, Parallel random numbers: as easy as 1, 2, 3.
"""

from __future__ import annotations

import hashlib

import numpy as np


class SampleNoise:
    """The random numbers of one sensor.

    Args:
        seed: Its seed.
        name: Its name.
    """

    def __init__(self, seed: int, name: str) -> None:
        key = np.frombuffer(hashlib.sha256(f"{seed} {name}".encode()).digest()[:16], dtype="<u8")
        self._bits = np.random.Philox(key=key)
        self._generator = np.random.Generator(self._bits)
        self._state = self._bits.state

    def of_sample(self, number: int) -> np.random.Generator:
        """The generator at the start of what a sample draws; the next call takes it back there."""
        self._state["state"]["counter"][3] = number  # counts up from the other end
        self._bits.state = self._state
        return self._generator
