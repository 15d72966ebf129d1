"""Timing and statistics of the simulation: pace on the steady clock, step times, contact quality."""

from __future__ import annotations

import threading
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from softsim_core.base import Array
from softsim_core.physics.dynamics import ContactReport, StepReport


class Pacer:
    """Due times of fixed steps: one every dt / speed seconds; the schedule restarts when steps fall behind.

    The step after a late one follows at once. If steps are behind by more than `tolerance_s`, the schedule
    restarts from now. No step is ever skipped: simulated time then runs slower, and `late_s` says by how
    much.

    Args:
        tolerance_s: How far steps may fall behind and still catch up, in [s].

    Attributes:
        late_s: Total time skipped by restarting the schedule, in [s].
    """

    def __init__(self, tolerance_s: float = 0.1) -> None:
        self.tolerance_s = tolerance_s
        self.late_s = 0.0
        self._due: float | None = None

    def start(self) -> None:
        """Start a new schedule at the next call of `wait_s`, for example after a pause."""
        self._due = None

    def wait_s(self, now: float, period_s: float) -> float:
        """Return the time in [s], >= 0, from the end of a step, `now` on a steady clock, until the next one.

        `period_s` is the time from step to step in [s]; 0 means as fast as possible.
        """
        if period_s <= 0.0:
            self._due = None
            return 0.0
        self._due = now + period_s if self._due is None else self._due + period_s
        behind = now - self._due
        if behind > self.tolerance_s:
            self.late_s += behind
            self._due = now
        return max(0.0, -behind)


@dataclass
class RateGate:
    """Limits a rate: allows at most one passage per `period_s` seconds on average, without drift.

    Attributes:
        period_s: Shortest mean time from one passage to the next, in [s].
    """

    period_s: float
    _due: float = field(default=-float("inf"), init=False)

    def passes(self, now: float) -> bool:
        """Return whether a passage is allowed at `now` (steady clock in [s]); True counts as a passage."""
        if now < self._due:
            return False
        late = now - self._due > self.period_s  # after a gap: no burst to catch up
        self._due = (now if late else self._due) + self.period_s
        return True


@dataclass(frozen=True)
class StageTime:
    """Times of one stage of the step over an interval of wall time, in [ms].

    Attributes:
        calls: Number of calls.
        minimum, mean, maximum, deviation: Time of one call, and its standard deviation.
    """

    calls: int
    minimum: float
    mean: float
    maximum: float
    deviation: float = 0.0

    @classmethod
    def of(cls, times_ms: Sequence[float]) -> StageTime:
        """Return the statistics of the times of some calls, at least one, in [ms]."""
        times = np.array(times_ms)
        minimum, maximum = float(times.min()), float(times.max())
        return cls(len(times), minimum, float(times.mean()), maximum, float(times.std()))

    @property
    def total(self) -> float:
        """Sum over all calls in [ms]."""
        return self.calls * self.mean


@dataclass(frozen=True)
class Speed:
    """Speed of the physics over one interval of wall time.

    Attributes:
        real_time_factor: Simulated over wall time, [-]; 0 while paused.
        steps_per_second: Steps done per second of wall time.
        cpu_ms: Mean processor time of a step in [ms], without the time that other programs and threads take.
        stages: Times of each stage of a step.
    """

    real_time_factor: float = 0.0
    steps_per_second: float = 0.0
    cpu_ms: float = 0.0
    stages: dict[str, StageTime] = field(default_factory=dict)

    @property
    def stages_ms(self) -> dict[str, float]:
        """Mean time of each stage in [ms]."""
        return {name: time.mean for name, time in self.stages.items()}


class SpeedMeter:
    """Collects step counts and stage times over intervals of about a second."""

    def __init__(self, dt: float, now: float) -> None:
        self._dt, self._since = dt, now
        self._steps, self._cpu_s = 0, 0.0
        self._stages: defaultdict[str, list[float]] = defaultdict(list)

    def add_step(self, stages_ms: dict[str, float], cpu_s: float = 0.0) -> None:
        """Count one step with the time of each of its stages in [ms], and its processor time in [s]."""
        self._steps += 1
        self._cpu_s += cpu_s
        for stage, time_ms in stages_ms.items():
            self._stages[stage].append(time_ms)

    def take(self, now: float) -> Speed:
        """Return the speed over the interval up to `now` (steady clock in [s]) and start a new one."""
        elapsed = max(now - self._since, 1e-9)
        steps = self._steps
        cpu_ms = 1e3 * self._cpu_s / max(steps, 1)
        stages = {stage: StageTime.of(times) for stage, times in self._stages.items()}
        self._since, self._steps, self._cpu_s = now, 0, 0.0
        self._stages.clear()
        return Speed(steps * self._dt / elapsed, steps / elapsed, cpu_ms, stages)


@dataclass(frozen=True)
class ContactQuality:
    """Quality of the contact solution over one interval of steps.

    Attributes:
        contacts: Number of contacts in the last step, including open ones within the alarm distance.
        residual: Largest residual of a step in [m]; it measures how far the contact forces were from the
            contact law.
        sweeps: Largest number of solver sweeps in a step.
        unsolved: Number of steps that stopped above the scene's tolerance.
    """

    contacts: int = 0
    residual: float = 0.0
    sweeps: int = 0
    unsolved: int = 0

    def with_step(self, report: ContactReport, tolerance: float) -> ContactQuality:
        """Return the quality with one more step; `tolerance` in [m] is the scene's."""
        return ContactQuality(
            contacts=len(report.points),
            residual=max(self.residual, report.residual),
            sweeps=max(self.sweeps, report.sweeps),
            unsolved=self.unsolved + (report.residual > tolerance),
        )

    @property
    def complaint(self) -> str:
        """Message for steps that stopped above the tolerance: how far off they were, and what to change."""
        return (
            f"contacts solved only to {self.residual:.1e} m in {self.unsolved} of the last steps: allow "
            "more contact.iterations, a larger contact.tolerance or a shorter dt"
        )

    def as_values(self) -> dict[str, object]:
        """Return the values for the diagnostics, by name."""
        return {
            "contacts": self.contacts,
            "contact_residual_m": self.residual,
            "contact_sweeps": self.sweeps,
            "unsolved_contact_steps": self.unsolved,
        }


@dataclass(frozen=True)
class Fallbacks:
    """Counts of steps over one interval, by StepReport.fallback.

    Attributes:
        steps: Number of steps.
        unpressed: Steps without the stiffness of the surfaces that actuators press on.
        clamped: Steps with the negative stiffness of each cell set to zero.
    """

    steps: int = 0
    unpressed: int = 0
    clamped: int = 0

    def with_step(self, report: StepReport) -> Fallbacks:
        """Return the counts with one more step."""
        return Fallbacks(
            self.steps + 1, self.unpressed + (report.fallback == 1), self.clamped + (report.fallback == 2)
        )

    def __bool__(self) -> bool:
        return self.unpressed + self.clamped > 0

    @property
    def complaint(self) -> str:
        """Message for steps that used a reduced stiffness: how many, why, and what to change."""
        return (
            f"{self.unpressed + self.clamped} of the last {self.steps} steps did without a part of their "
            "stiffness, as the body is about to buckle or to be torn: change commands more slowly, or "
            "shorten dt"
        )

    def as_values(self) -> dict[str, object]:
        """Return the values for the diagnostics, by name."""
        return {
            "steps_without_pressed_stiffness": self.unpressed,
            "steps_with_clamped_stiffness": self.clamped,
        }


LENGTH: Final = 1000
"""Number of steps in the history."""


class StepHistory:
    """The last steps with their stage times; filled from one thread, read from any."""

    def __init__(self, length: int = LENGTH) -> None:
        self._length, self._count = length, 0
        self._stages: tuple[str, ...] = ()
        self._rows = np.zeros((length, 0))
        self._lock = threading.Lock()

    def add(self, step: int, time_s: float, stages_ms: Mapping[str, float]) -> None:
        """Store one more step; other stage names, or a step number that does not grow, start a new history.

        Args:
            step: Number of the step.
            time_s: Simulated time at its end in [s].
            stages_ms: Time of each stage in [ms].
        """
        stages = tuple(stages_ms)
        with self._lock:
            last = self._rows[(self._count - 1) % self._length, 0] if self._count else -1
            if stages != self._stages or step <= last:
                self._stages, self._count = stages, 0
                self._rows = np.zeros((self._length, 2 + len(stages)))
            self._rows[self._count % self._length] = (step, time_s, *stages_ms.values())
            self._count += 1

    def steps(self) -> tuple[tuple[str, ...], Array]:
        """Return the stage names and one row per step, oldest first.

        A row contains the step number, the time in [s] and the stage times in [ms].
        """
        with self._lock:
            stored_count = min(self._count, self._length)
            order = np.arange(self._count - stored_count, self._count) % self._length
            return self._stages, self._rows[order]
