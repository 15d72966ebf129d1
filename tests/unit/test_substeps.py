"""Steps cut in halves: what each half is told, how often they are cut, what a failure does."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from small_scenes import body, scene

from softsim_core.base import FactorisationError, SceneError
from softsim_core.physics.actuation import Actuators
from softsim_core.physics.dynamics import StepReport, StepSettings, TimeStep
from softsim_core.physics.mechanics import Control, Model, Parameters, State
from softsim_core.physics.mesh import box_mesh, quadratic
from softsim_core.scene import JointDescription, SolverSettings
from softsim_core.scene.building import build


class Shearing:
    """Stands in for a step: shears at a rate [1/s], or fails, and notes what it was told."""

    name, compiled = "shearing", False
    actuators = Actuators()

    def __init__(
        self, model: Model, rate: float, fails_above: float, told: list[tuple[float, Control]]
    ) -> None:
        self.model, self.rate, self.fails_above, self.told = model, rate, fails_above, told

    def step(self, state: State, control: Control, parameters: Parameters) -> StepReport:
        self.told.append((self.model.dt, control))
        state.positions[:, 0] += self.rate * self.model.dt * self.model.rest[:, 2]
        if self.model.dt > self.fails_above:
            raise FactorisationError("too long")
        state.joint_positions[:] = control.targets
        state.base_shift[0] = control.base_shift
        return StepReport(times={"solve": 1.0})


def stepper(
    rate: float, most: int = 8, fails_above: float = 1.0, actuators: Any = Shearing.actuators
) -> tuple[TimeStep, Any, list[Any]]:
    cell = replace(body(quadratic(box_mesh((0.01, 0.01, 0.01), (1, 1, 1)))), order=2)
    joints = (JointDescription(name="servo"), JointDescription(name="spring", stiffness=2.0))
    model, told = build(scene(cell, joints=joints)).model, []
    made = TimeStep(
        model,
        actuators,
        StepSettings(parts=most),
        lambda model, like: Shearing(model, rate, fails_above, told),  # type: ignore[arg-type, return-value]
        lambda _: None,
    )
    return made, model.rest_state(), told


CONTROL = Control(np.array([0.4, 0.8]), np.zeros((27, 3)), base_shift=0.01)


def advance(made: TimeStep, state: State) -> StepReport:
    return made.step(state, CONTROL, Parameters([{}], 0.0, 0.0))


def test_a_command_of_pressure_is_the_same_in_each_half() -> None:
    """It is no place that a joint is on its way to."""
    pump = SimpleNamespace(paced=np.array([0]), joint=np.array([0]), internal_size=0, end=lambda *_: None)
    made, state, told = stepper(rate=100.0, most=2, actuators=pump)
    advance(made, state)
    first = next(control for dt, control in told if dt == 0.005)
    assert first.targets.tolist() == [0.4, 0.8]
    assert first.base_shift == 0.005


def test_a_step_that_strains_little_is_whole() -> None:
    made, state, told = stepper(rate=20.0)
    assert advance(made, state).parts == 1
    assert [dt for dt, _ in told] == [0.01]


@pytest.mark.parametrize(("most", "parts"), [(1, 1), (2, 2), (4, 4), (8, 4)])
def test_a_rough_one_is_cut_as_long_as_it_is_rough(most: int, parts: int) -> None:
    """Sheared by 1 in 10 ms: 0.87 of Green strain, at most 0.51 in half of it, 0.28 in a quarter."""
    made, state, told = stepper(rate=100.0, most=most)
    report = advance(made, state)
    assert report.parts == parts
    assert report.times == {"solve": float(len(told))}
    done = [dt for dt, _ in told if dt == 0.01 / parts]
    assert len(done) == parts
    np.testing.assert_allclose(state.positions[:, 0], (made.model.rest @ [1.0, 0.0, 1.0]), atol=1e-15)


def test_motions_go_half_the_way_and_springs_pull_as_they_do() -> None:
    made, state, told = stepper(rate=60.0)
    rest = state.joint_positions.copy()
    advance(made, state)
    (_, whole), (_, first), (_, second) = told
    assert whole is CONTROL is second
    assert first.targets.tolist() == [0.5 * (rest[0] + 0.4), 0.8]
    assert first.base_shift == pytest.approx(0.005)
    assert state.joint_positions.tolist() == [0.4, 0.8]


def test_a_matrix_that_cannot_be_factored_cuts_the_step_too() -> None:
    made, state, _ = stepper(rate=0.0, fails_above=0.003)
    assert advance(made, state).parts == 4


def test_the_last_failure_is_told() -> None:
    made, state, _ = stepper(rate=0.0, fails_above=0.0)
    with pytest.raises(FactorisationError, match="too long"):
        advance(made, state)


def test_other_numbers_of_parts_are_refused() -> None:
    with pytest.raises(SceneError, match="substeps must be one of 1, 2, 4, 8, 16, 32, 64, not 3"):
        SolverSettings(substeps=3)
