r"""How bodies turn as a whole within a step: what its damping and its stiffness leave out.

Damping per stiffness is of the strains that change: a turning of the body changes none. Over a step of h that
turns a body by the rotation R the nodes at x move by (R - I) x, and the velocity (R - I) x / h has, taken for
a rate of strain, the contraction

.. math:: \frac{\cos a - 1}{h} \approx -\frac{a^2}{2 h} = -\frac{h \omega^2}{2}

so that K v would stretch the body by :math:`r_K h \omega^2 / 2`, and the stiffness within a linearised step
by :math:`h^2 \omega^2 / 2`. Iterated steps take the way of the nodes less the turning of their body.

A step that is linearised once does so for bodies that nothing holds, of laws with a potential. It adds the
force -lag K v to the right-hand side. K of stressed elements answers a rotation w of the body with the
turning of its forces, K (w x r) = -w x f: to first order right, but taken where the body was, which brakes
the spin of a free body by (h w)^2 per step. All other bodies keep K v as the reference simulator has it, and
are dilated as above; see StepReport.dilation.
"""

from __future__ import annotations

import numpy as np

from softsim_core.arrays import Array
from softsim_core.mechanics.control import Control
from softsim_core.mechanics.model import FREE, Model
from softsim_core.mechanics.pose import rotation_exp
from softsim_core.mechanics.state import State


class FreeTurning:
    """The bodies of a model, and those whose nodes are all free, of laws with a potential.

    Attributes:
        bodies: Nodes of each of the latter, shape (k,).
        held: Nodes of each of the others, shape (k,).
    """

    def __init__(self, model: Model) -> None:
        self._mass, self._dt = model.mass, model.dt
        held: set[int] = set()
        nodes: dict[int, list[Array]] = {}
        for group in model.groups:
            for body in np.unique(group.body).tolist():
                own = np.unique(group.cells[group.body == body])
                nodes.setdefault(body, []).append(own)
                still = (model.region_of_node[own] != FREE).any() or model.spring[own].any()
                if still or not group.material.has_potential:
                    held.add(body)
        every = {body: np.unique(np.concatenate(own)) for body, own in nodes.items()}
        self.bodies = [own for body, own in every.items() if body not in held]
        self.held = [own for body, own in every.items() if body in held]

    def lagging(self, state: State, control: Control, share: float) -> Array:
        """The velocities (n, 3) that a step takes K by, with a `share` of those that are carried."""
        result = self._without_turning(state.positions, state.velocities)
        return result if control.carried is None else np.asarray(result + share * control.carried)

    def turned(self, places: Array, onto: Array) -> Array:
        """Places (n, 3) in [m] with bodies turned and moved as a whole to how they lie at others (n, 3)."""
        result = places.copy()
        for own in (*self.bodies, *self.held):
            centre, middle, rotation = self._fitted(own, places, onto)
            result[own] = middle + (places[own] - centre) @ rotation
        return result

    def dilation(self, before: Array, after: Array) -> float:
        """Largest a^2 / 2 of the held bodies, which turn by a between places (n, 3) in [m]."""
        turns = [self._fitted(own, before, after)[2] for own in self.held]
        return max((0.5 * (3.0 - float(np.trace(turn))) for turn in turns), default=0.0)

    def _fitted(self, own: Array, places: Array, onto: Array) -> tuple[Array, Array, Array]:
        """Centres of mass (3,) of a body at both places, and how it has turned: x R, for arms x (k, 3)."""
        mass = self._mass[own, None]
        centre, middle = ((mass * each[own]).sum(axis=0) / mass.sum() for each in (places, onto))
        u, _, vt = np.linalg.svd((mass * (places[own] - centre)).T @ (onto[own] - middle))
        u[:, 2] *= np.linalg.det(u @ vt)  # no reflection
        return centre, middle, u @ vt

    def _without_turning(self, positions: Array, velocities: Array) -> Array:
        """Velocities (n, 3) in [m/s] less the turning of free bodies about their centres of mass."""
        if not self.bodies:
            return velocities
        result = velocities.copy()
        for own in self.bodies:
            mass, points = self._mass[own, None], positions[own]
            total = mass.sum()
            arms = points - (mass * points).sum(axis=0) / total
            drift = velocities[own] - (mass * velocities[own]).sum(axis=0) / total
            momentum = np.cross(arms, mass * drift).sum(axis=0)
            inertia = (mass * (arms**2).sum(axis=1, keepdims=True)).sum() * np.eye(3) - (mass * arms).T @ arms
            spin = np.linalg.lstsq(inertia, momentum, rcond=None)[0]
            result[own] -= arms @ (rotation_exp(self._dt * spin).T - np.eye(3)) / self._dt
        return result
