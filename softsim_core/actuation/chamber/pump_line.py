r"""The line between a pump and a hollow: what its air takes up, what leaks out of it, what the pump can do.

The amount a is the air that was pumped in and is still there, as the volume in [m^3] that it has in the
atmosphere. With the volume V of hollow and line when the scene was built and the gauge pressure p, each part
of the air follows :math:`(P_0 + p) V^k = const` from the atmosphere on:

.. math:: s + V + c p = (V + a) \, r(p), \quad r(p) = (1 + p / P_0)^{-1/k}

c being what hoses take up by themselves. With 1 / k = 0 that is water, which does not compress.
"""

from __future__ import annotations

from dataclasses import dataclass

LEAST = 1e-3
"""Pressure against vacuum as a part of the atmosphere's, and air as a part of what was there, from which on a
pump pulls out no more."""


@dataclass(frozen=True, slots=True)
class PumpLine:
    """A line, see the module.

    Attributes:
        volume: V in [m^3].
        atmosphere: P0 in [Pa].
        softness: 1 / k in [-].
        compliance: c in [m^3/Pa].
        leak: What leaks out, as volume in the atmosphere in [m^3/s], per gauge pressure in [Pa].
        flow_limit: Most that the pump moves in or out, as volume in the atmosphere in [m^3/s].
    """

    volume: float
    atmosphere: float
    softness: float
    compliance: float
    leak: float
    flow_limit: float

    def share(self, pressure: float) -> float:
        """R(p) in [-], what is left at a gauge pressure in [Pa] of the volume of air in the atmosphere."""
        return float(max(1.0 + pressure / self.atmosphere, LEAST) ** -self.softness)

    def growth(self, amount: float, pressure: float) -> float:
        """By how much the hollow has grown, s in [m^3], with an amount in [m^3] at a pressure in [Pa]."""
        if self.softness == 0.0:
            return amount - self.compliance * pressure
        left = self._content(amount) * self.share(pressure) - self.volume
        return left - self.compliance * pressure

    def slope(self, amount: float, pressure: float) -> float:
        """-ds/dp of `growth` in [m^3/Pa], >= 0."""
        absolute = max(self.atmosphere + pressure, LEAST * self.atmosphere)
        return self.compliance + self._content(amount) * self.share(pressure) * self.softness / absolute

    def amount(self, growth: float, pressure: float) -> float:
        """The amount in [m^3] with which a hollow that has grown by s in [m^3] has a pressure in [Pa]."""
        taken_up = growth + self.compliance * pressure
        if self.softness == 0.0:
            return taken_up
        return (self.volume + taken_up) / self.share(pressure) - self.volume

    def _content(self, amount: float) -> float:
        return max(self.volume + amount, LEAST * self.volume)
