"""Whether a model is right: by how far measurements lie from it, and by what had to be learned for that."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from softsim_core.observer.belief import Belief
from softsim_core.observer.jump import chi_square_limit
from softsim_core.observer.unknowns import Unknowns

SURE = 1e-9
"""Chance with which a right model is called wrong, per look at the innovations of a window."""

IMPLAUSIBLE = 5.0
"""What was learned of an unknown may be so many standard deviations of its prior."""


class Judge:
    """Keeps the normalised innovations v^T S^-1 v of a window; their sum is chi-square distributed.

    Args:
        steps: So many steps are looked at.
        unknowns, prior: What is learned, and what was believed of it before.

    Source: Bar-Shalom, Li and Kirubarajan 2001, consistency of filters (normalised innovation squared).
    """

    def __init__(self, steps: int, unknowns: Unknowns, prior: Belief) -> None:
        self._seen: deque[tuple[float, int]] = deque(maxlen=max(1, steps))
        self._unknowns, self._prior = unknowns, prior.deviation

    def take(self, distance: float, freedom: int) -> None:
        """Take v^T S^-1 v of a step that measured `freedom` coordinates."""
        self._seen.append((distance, freedom))

    @property
    def consistency(self) -> float:
        """Mean of v^T S^-1 v per coordinate: 1 where all is as believed, or where nothing was seen."""
        freedom = sum(m for _, m in self._seen)
        return sum(each for each, _ in self._seen) / freedom if freedom else 1.0

    def sentence(self, belief: Belief) -> str:
        """What speaks against the model; empty: nothing."""
        freedom, ratio = sum(m for _, m in self._seen), self.consistency
        if freedom and ratio * freedom > chi_square_limit(freedom, SURE):
            return (
                f"measurements are {math.sqrt(ratio):.1f} times as far from the model as its and their "
                "uncertainty allow: the model, or the noise that the sensors are said to have, is wrong"
            )
        known = np.flatnonzero(self._prior)
        far = np.abs(belief.mean[known]) / self._prior[known]
        if far.max(initial=0.0) <= IMPLAUSIBLE:
            return ""
        name = self._unknowns.name(int(known[np.argmax(far)]))
        return f"{name} had to be taken {far.max():.1f} times as far off as the model may be"
