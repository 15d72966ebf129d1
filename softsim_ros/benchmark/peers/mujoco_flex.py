"""The held body as a flex of MuJoCo: St. Venant-Kirchhoff tetrahedra, integrator `discrete`, no contact.

That integrator solves its implicit step by iterations. Their default number, 100, is not enough here: MuJoCo
warns that the solve has not converged. It is measured both ways.
"""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree

import numpy as np

from softsim_core.arrays import Array
from softsim_ros.benchmark.machine import version_of
from softsim_ros.benchmark.peers.body import HeldBody, PeerMissingError

CONVERGED_ITERATIONS = 3000
DEFAULT_ITERATIONS = 100
INSTALL = "pip install 'softsim[peers]' (MuJoCo 3.13 or newer)"


class MujocoFlex:
    """See Engine.

    Args:
        body: What to simulate.
        iterations: Most iterations of a step's solve.

    Raises:
        PeerMissingError: MuJoCo is not installed or has no integrator `discrete`.
    """

    def __init__(self, body: HeldBody, iterations: int = CONVERGED_ITERATIONS) -> None:
        try:
            import mujoco
        except ImportError as error:
            raise PeerMissingError(f"MuJoCo is not measured ({error}): {INSTALL}") from error
        self.version = version_of("mujoco-core") or version_of("mujoco") or ""
        if not hasattr(mujoco.mjtIntegrator, "mjINT_DISCRETE"):
            raise PeerMissingError(
                f"MuJoCo is not measured (version {self.version} has no integrator discrete): {INSTALL}"
            )
        self.name = "mujoco" if iterations > DEFAULT_ITERATIONS else "mujoco_unconverged"
        self.method = f"St. Venant-Kirchhoff, integrator discrete, at most {iterations} iterations"
        mujoco.set_mju_user_warning(_keep_quiet)  # else: to stderr and to a file in the current folder
        self._reset = mujoco.mj_resetData
        self._model: Any = mujoco.MjModel.from_xml_string(describe(body, iterations))
        self._data: Any = mujoco.MjData(self._model)
        self.rests = True
        self._step = mujoco.mj_step
        mujoco.mj_forward(self._model, self._data)

    @property
    def warnings(self) -> int:
        """Number of warnings since the start: one per step whose solve did not converge."""
        return int(self._data.warning.number.sum())

    def restart(self) -> None:
        """See Engine."""
        self._reset(self._model, self._data)

    def advance(self) -> None:
        """See Engine."""
        self._step(self._model, self._data)

    def points(self) -> Array:
        """See Engine."""
        return np.array(self._data.flexvert_xpos)


def describe(body: HeldBody, iterations: int) -> str:
    """The body as an MJCF document."""
    root = ElementTree.Element("mujoco", model="held_body")
    option = _add(
        root,
        "option",
        timestep=_words([body.dt]),
        integrator="discrete",
        iterations=str(iterations),
        gravity=_words(body.gravity),
    )
    _add(option, "flag", contact="disable")
    flex = _add(
        _add(root, "worldbody"),
        "flexcomp",
        name="body",
        type="direct",
        dim="3",
        mass=_words([body.total_mass]),
        radius="0.0001",  # m; of contacts only, which are off
        point=_words(body.points),
        element=_words(body.tets),
    )
    _add(flex, "contact", selfcollide="none", contype="0", conaffinity="0")
    _add(
        flex,
        "elasticity",
        young=_words([body.young_modulus]),
        poisson=_words([body.poisson_ratio]),
        damping="0",
    )
    _add(flex, "pin", id=_words(body.held))
    return ElementTree.tostring(root, encoding="unicode")


def _keep_quiet(_: str) -> None:
    """Warnings are counted, see MujocoFlex.warnings."""


def _add(parent: ElementTree.Element, tag: str, /, **attributes: str) -> ElementTree.Element:
    return ElementTree.SubElement(parent, tag, attributes)


def _words(numbers: Any) -> str:
    return " ".join(repr(number) for number in np.asarray(numbers).ravel().tolist())
