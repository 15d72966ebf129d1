"""How many steps lately did without a part of their stiffness, for the diagnostics."""

from __future__ import annotations

from dataclasses import dataclass

from softsim_core.dynamics.report import StepReport


@dataclass(frozen=True)
class Fallbacks:
    """Steps of one stretch by StepReport.fallback.

    Attributes:
        steps: How many there were.
        unpressed: Without the stiffness of what actuators press on.
        clamped: With the negative stiffness of each cell taken as zero.
    """

    steps: int = 0
    unpressed: int = 0
    clamped: int = 0

    def with_step(self, report: StepReport) -> Fallbacks:
        """The same after one more step."""
        return Fallbacks(
            self.steps + 1, self.unpressed + (report.fallback == 1), self.clamped + (report.fallback == 2)
        )

    def __bool__(self) -> bool:
        return self.unpressed + self.clamped > 0

    @property
    def complaint(self) -> str:
        """What is wrong where there were some."""
        return (
            f"{self.unpressed + self.clamped} of the last {self.steps} steps did without a part of their "
            "stiffness, as the body is about to buckle or to be torn: change commands more slowly, or "
            "shorten dt"
        )

    def as_values(self) -> dict[str, object]:
        """Values for the diagnostics."""
        return {
            "steps_without_pressed_stiffness": self.unpressed,
            "steps_with_clamped_stiffness": self.clamped,
        }
