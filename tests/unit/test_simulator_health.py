"""The simulator's line in /diagnostics."""

from __future__ import annotations

import pytest

pytest.importorskip("diagnostic_msgs", reason="the message packages are not installed")

from softsim_core.physics.dynamics import StepReport
from softsim_ros.messages import ERROR, OK, WARN
from softsim_ros.nodes.simulator import Fallbacks, PhysicsStatus, health


@pytest.mark.parametrize(("count", "told"), [(1, "1 element is inside"), (7, "7 elements are inside")])
def test_elements_that_are_inside_out_are_counted_and_warned_of(count: int, told: str) -> None:
    level, sentence, values = health(PhysicsStatus(inverted_elements=count), True, 0.0)
    assert level == WARN
    assert sentence.startswith(told)
    assert values["inverted_elements"] == count


def test_a_fault_stands_before_what_is_inside_out() -> None:
    status = PhysicsStatus(inverted_elements=3, fault="diverged")
    assert health(status, True, 0.0)[:2] == (ERROR, "diverged")
    assert health(PhysicsStatus(), True, 0.0)[0] == OK


def test_steps_that_fell_back_are_counted_in_one_sentence() -> None:
    """Each by what it did without; a second without any is well again."""
    counted = Fallbacks()
    for fallback in (0, 1, 2, 2, 0):
        counted = counted.with_step(StepReport(fallback=fallback))
    level, sentence, values = health(PhysicsStatus(fallbacks=counted), True, 0.0)
    assert level == WARN
    assert sentence.startswith("3 of the last 5 steps did without a part of their stiffness")
    assert values["steps_without_pressed_stiffness"] == 1
    assert values["steps_with_clamped_stiffness"] == 2
    assert not Fallbacks().with_step(StepReport())
