"""Forces of contacts with Coulomb friction and of bounded rows: Gauss-Seidel, Newton, smoothed projection."""

from __future__ import annotations

from softsim_core.physics.contact.solver.gauss_seidel import ContactSolution, solve_contacts

__all__ = ["ContactSolution", "solve_contacts"]
