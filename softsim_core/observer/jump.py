"""Detection of a jump of some unknowns by the innovations of a filter that does not know of it.

Under the jump c the innovations of the last n steps are v_k = G_k c + e_k with e_k of covariance S_k, so

    J = sum G^T S^-1 G,    b = sum G^T S^-1 v,    c = (J + L)^-1 b,    T = b^T (J + L)^-1 b

with L the inverse of the covariance that jumps have. Without a jump T is at most chi-square distributed; the
longest of several windows whose T is beyond the threshold wins. That the filter follows a jump meanwhile is
left out: what it learns of slow unknowns within so short a time is little.

Source: Willsky and Jones 1976, generalised likelihood ratio for jumps in linear systems.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from scipy.special import gammainccinv

from softsim_core.arrays import Array

WINDOWS = (1, 2, 3, 5, 8, 12, 18)
"""Numbers of steps that are looked at, each of them at every step."""


@dataclass(frozen=True, slots=True, eq=False)
class Jump:
    """A jump that was found.

    Attributes:
        steps: So many steps ago it began, this one included.
        mean, covariance: What the innovations since then say of it, shapes (c,) and (c, c).
        statistic: T.
    """

    steps: int
    mean: Array
    covariance: Array
    statistic: float


class JumpDetector:
    """Looks for a jump of c unknowns.

    Args:
        prior: Standard deviation of jumps, shape (c,).
        false_alarms: Expected number per step without any jump, as if all windows were independent.
    """

    def __init__(self, prior: Array, false_alarms: float) -> None:
        self._limit = np.diag(1.0 / prior**2)
        self.threshold = chi_square_limit(max(len(prior), 1), false_alarms / len(WINDOWS))
        self._seen: deque[tuple[Array, Array]] = deque(maxlen=WINDOWS[-1])

    def forget(self) -> None:
        """Begin anew."""
        self._seen.clear()

    def look(self, innovation: Array, rows: Array, covariance: Array) -> Jump | None:
        """The likeliest jump, if any, after another step's innovation v (m,), G (m, c) and S (m, m)."""
        weighted = np.linalg.solve(covariance, np.column_stack([rows, innovation]))
        self._seen.append((rows.T @ weighted[:, :-1], rows.T @ weighted[:, -1]))
        best: Jump | None = None
        information, score, done = self._limit.copy(), np.zeros(len(self._limit)), 0
        for window in WINDOWS:
            if window > len(self._seen):
                break
            for back in range(done, window):
                each = self._seen[-1 - back]
                information += each[0]
                score += each[1]
            done = window
            mean = np.linalg.solve(information, score)
            statistic = float(score @ mean)
            if statistic > self.threshold and (best is None or statistic > best.statistic):
                best = Jump(window, mean, np.linalg.inv(information), statistic)
        return best


def chi_square_limit(freedom: int, chance: float) -> float:
    """What a chi-square variable of so many degrees of freedom exceeds with a given chance."""
    return 2.0 * float(gammainccinv(0.5 * freedom, chance))
