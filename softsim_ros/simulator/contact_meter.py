"""How well contacts were solved lately, for the diagnostics."""

from __future__ import annotations

from dataclasses import dataclass

from softsim_core.dynamics.report import ContactReport


@dataclass(frozen=True)
class ContactQuality:
    """Contacts of one stretch of steps.

    Attributes:
        contacts: How many there were in the last step, open ones within the alarm distance too.
        residual: Largest residual of a step in [m]: how far its forces were from the contact law.
        sweeps: Most sweeps of the contact solver in a step.
        unsolved: Steps that stopped above the tolerance of the scene.
    """

    contacts: int = 0
    residual: float = 0.0
    sweeps: int = 0
    unsolved: int = 0

    def with_step(self, report: ContactReport, tolerance: float) -> ContactQuality:
        """The same after one more step; `tolerance` in [m] is what the scene asks for."""
        return ContactQuality(
            contacts=len(report.points),
            residual=max(self.residual, report.residual),
            sweeps=max(self.sweeps, report.sweeps),
            unsolved=self.unsolved + (report.residual > tolerance),
        )

    @property
    def complaint(self) -> str:
        """What is wrong where steps stopped above the tolerance."""
        return (
            f"contacts solved only to {self.residual:.1e} m in {self.unsolved} of the last steps: allow "
            "more contact.iterations, a larger contact.tolerance or a shorter dt"
        )

    def as_values(self) -> dict[str, object]:
        """Values for the diagnostics."""
        return {
            "contacts": self.contacts,
            "contact_residual_m": self.residual,
            "contact_sweeps": self.sweeps,
            "unsolved_contact_steps": self.unsolved,
        }
