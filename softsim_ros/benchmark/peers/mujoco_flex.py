"""MuJoCo as an engine: the clamped body as a flex, or a model from its own file.

The integrator `discrete` solves its implicit step by iterations. The default number, 100, is not enough for
the clamped body: MuJoCo warns that the solve has not converged. Both the default and a sufficient number are
measured.
"""

from __future__ import annotations

from pathlib import Path

from softsim_core.base import MjcfError
from softsim_core.mjcf import ITERATIONS, MujocoRun, export_mjcf
from softsim_ros.benchmark.peers.body import ClampedBody, PeerMissingError

DEFAULT_ITERATIONS = 100


class MujocoEngine(MujocoRun):
    """A model that runs in MuJoCo, with the name and method that the comparison reports.

    Args:
        model: A file, or an MJCF document.

    Raises:
        MjcfError: MuJoCo is not installed, or refuses the model.
    """

    name = "mujoco"
    rests = True

    def __init__(self, model: Path | str) -> None:
        super().__init__(model)
        most = int(self.model.opt.iterations)
        self.method = f"Saint Venant-Kirchhoff, integrator {self.integrator}, at most {most} iterations"


class MujocoFlex(MujocoEngine):
    """The clamped body in MuJoCo, written as a flex by our own MJCF export.

    Args:
        body: What to simulate.
        iterations: Maximum number of iterations of a step's solve.

    Raises:
        PeerMissingError: MuJoCo is not installed or has no integrator `discrete`.
    """

    def __init__(self, body: ClampedBody, iterations: int = ITERATIONS) -> None:
        try:
            super().__init__(export_mjcf(body.scene, iterations).text)
        except MjcfError as error:
            raise PeerMissingError(f"MuJoCo is not measured: {error.reason}") from error
        self.name = "mujoco" if iterations > DEFAULT_ITERATIONS else "mujoco_unconverged"
