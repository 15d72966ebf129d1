"""What fails behind a door becomes one short sentence."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy")

from rcl_interfaces.msg import SetParametersResult
from std_srvs.srv import Trigger

from softsim_core.base import CommandError
from softsim_node import (
    LONGEST_MESSAGE,
    REFUSAL_PERIOD_S,
    Refusals,
    error_message,
    guard_parameters,
    guard_service,
    guard_subscription,
    one_line,
)

pytestmark = pytest.mark.ros


def failing(*_: object) -> None:
    raise ValueError("bad\nvalue\x1b[31m" + 500 * "x")


def test_sentences_are_short_and_on_one_line() -> None:
    assert error_message(CommandError("refused: no such joint")) == "refused: no such joint"
    sentence = error_message(ValueError("bad\nvalue\x1b[31m" + 10**6 * "x"))
    assert sentence.startswith("refused: ValueError (bad value [31m")
    assert len(sentence) == LONGEST_MESSAGE
    assert error_message(KeyError()) == "refused: KeyError"
    assert one_line("é ü") == "é ü"


def test_a_flood_of_refusals_is_a_few_lines_a_period() -> None:
    now, said = [0.0], list[str]()
    refusals = Refusals(said.append, lambda: now[0])
    for k in range(1000):
        refusals.report(f"pull refused: no place mesh_point/{k}")
    assert said == ["pull refused: no place mesh_point/0"]
    for k in range(1000):
        refusals.report(f"{k:04d} is another one")
    assert len(said) == 10
    now[0] = REFUSAL_PERIOD_S
    refusals.report("pull refused: no place mesh_point/1")
    assert len(said) == 11


def test_a_message_that_fails_is_told_and_forgotten() -> None:
    said: list[str] = []
    guard_subscription(failing, said.append, "joint_states")(object())
    assert len(said) == 1
    assert said[0].startswith("message on joint_states refused: ValueError")


def test_a_request_that_fails_is_answered() -> None:
    said: list[str] = []
    answer = guard_service(failing, said.append, "save")(Trigger.Request(), Trigger.Response(success=True))
    assert not answer.success
    assert answer.message.startswith("refused: ValueError")
    assert len(answer.message) <= LONGEST_MESSAGE
    assert len(said) == 1


def test_parameters_that_fail_are_refused_and_long_reasons_are_cut() -> None:
    said: list[str] = []
    result = guard_parameters(failing, said.append)([])
    assert not result.successful
    assert result.reason.startswith("refused: ValueError")
    long = guard_parameters(lambda _: SetParametersResult(successful=False, reason=10**6 * "y"), said.append)(
        []
    )
    assert len(long.reason) == LONGEST_MESSAGE
