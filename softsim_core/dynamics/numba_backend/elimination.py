"""The seam between the compiled step and what eliminates its free nodes: a factor, or iteration.

Either leaves what the free nodes make of the reduced coordinates in `Work.factor.schur`, and panels from
which `solve_backward` finds the free nodes once the reduced coordinates are known.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from softsim_core.dynamics.numba_backend.layout import Work
from softsim_core.dynamics.numba_backend.prepare import Prepared
from softsim_core.dynamics.numba_backend.responses import Responses
from softsim_core.linalg.layout import Tree


class Elimination(Protocol):
    """See the module.

    Attributes:
        stages: Names of the three stages of a step.
        iterations: Of conjugate gradients in the last step, for all right-hand sides; 0: there are none.
        prepared: What a step fills in before it.
        responses: What forces on rows do after it.
    """

    stages: tuple[str, str, str]
    iterations: int
    prepared: Prepared
    responses: Responses

    def tuned(self, rest: Callable[[], tuple[Any, ...]]) -> None:
        """Parameters have changed; `rest()` gives the arguments that `advance.assemble` takes at rest."""
        ...

    def advance(self, *arguments: Any) -> tuple[float, int, float, float, float]:
        """One whole step, with the arguments and results of `advance.advance`.

        Raises:
            FactorisationError: the step needs a factor; nothing has moved.
        """
        ...


def assembling(arguments: tuple[Any, ...]) -> tuple[Any, ...]:
    """Of the arguments of `advance.advance` those of `advance.assemble`."""
    motion, straining, external, *_ = arguments
    return motion, straining, external, *arguments[7:16]


def finishing(arguments: tuple[Any, ...], tree: Tree, work: Work) -> tuple[Any, ...]:
    """Of the arguments of `advance.advance` those of `advance.finish`, with that tree and room."""
    motion, kinematics, nodes, acting = (arguments[i] for i in (0, 10, 12, 13))
    return motion, *arguments[3:9], kinematics, tree, nodes, acting, work


def without_actuators(arguments: tuple[Any, ...]) -> tuple[Any, ...]:
    """The arguments of `advance.advance` for a step that has none."""
    return *arguments[:13], None, *arguments[14:]
