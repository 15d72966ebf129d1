"""How bodies that nothing holds turn as a whole: what the step leaves out of its damping.

The step adds the force -lag K v to the right-hand side. K of stressed elements answers a rotation w of the
body with the turning of its forces, K (w x r) = -w x f: to first order right, but taken where the body was,
which brakes the spin of a free body by (h w)^2 per step. Of such bodies, v is taken without that rotation.
"""

from __future__ import annotations

import numpy as np

from softsim_core.arrays import Array
from softsim_core.mechanics.control import Control
from softsim_core.mechanics.model import FREE, Model
from softsim_core.mechanics.state import State


class FreeTurning:
    """The bodies of a model whose nodes are all free, of laws with a potential.

    Attributes:
        bodies: Nodes of each of them, shape (k,).
    """

    def __init__(self, model: Model) -> None:
        self._mass = model.mass
        held: set[int] = set()
        nodes: dict[int, list[Array]] = {}
        for group in model.groups:
            for body in np.unique(group.body).tolist():
                own = np.unique(group.cells[group.body == body])
                nodes.setdefault(body, []).append(own)
                still = (model.region_of_node[own] != FREE).any() or model.spring[own].any()
                if still or not group.material.has_potential:
                    held.add(body)
        self.bodies = [np.unique(np.concatenate(own)) for body, own in nodes.items() if body not in held]

    def lagging(self, state: State, control: Control, share: float) -> Array:
        """The velocities (n, 3) that a step takes K by, with a `share` of those that are carried."""
        result = self.straining(state.positions, state.velocities)
        if control.carried is None:
            return result
        return np.asarray(result + share * self.straining(state.positions, control.carried))

    def turned(self, places: Array, onto: Array) -> Array:
        """Places (n, 3) in [m] with free bodies turned as a whole to how they lie at other places (n, 3)."""
        if not self.bodies:
            return places
        result = places.copy()
        for own in self.bodies:
            mass = self._mass[own, None]
            centre, middle = ((mass * each[own]).sum(axis=0) / mass.sum() for each in (places, onto))
            arms = places[own] - centre
            u, _, vt = np.linalg.svd((mass * arms).T @ (onto[own] - middle))
            u[:, 2] *= np.linalg.det(u @ vt)  # no reflection
            result[own] = centre + arms @ (u @ vt)
        return result

    def straining(self, positions: Array, velocities: Array) -> Array:
        """Velocities (n, 3) in [m/s] without the turning of free bodies about their centres of mass."""
        if not self.bodies:
            return velocities
        result = velocities.copy()
        for own in self.bodies:
            mass, points = self._mass[own, None], positions[own]
            total = mass.sum()
            arms = points - (mass * points).sum(axis=0) / total
            drift = velocities[own] - (mass * velocities[own]).sum(axis=0) / total
            spin = np.cross(arms, mass * drift).sum(axis=0)
            inertia = (mass * (arms**2).sum(axis=1, keepdims=True)).sum() * np.eye(3) - (mass * arms).T @ arms
            result[own] -= np.cross(np.linalg.lstsq(inertia, spin, rcond=None)[0], arms)
        return result
