"""Parameters from a dataclass: start values, refusals, and changes that happen whole or not at all."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

from rcl_interfaces.msg import ParameterType  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.parameter import Parameter, get_parameter_value  # noqa: E402

from softsim_core.base import CommandError  # noqa: E402
from softsim_core.scene.io import read_overrides  # noqa: E402
from softsim_node import (  # noqa: E402
    GuardedNode,
    LiveParameters,
    ParameterError,
    Program,
    declare,
    parameter,
)

REPOSITORY = Path(__file__).resolve().parents[2]


@dataclass(frozen=True, kw_only=True)
class Settings:
    gain: float = parameter(1.0, "A gain", unit="1/s", within=(0.0, 10.0))
    lowest: float = parameter(0.0, "Not above the gain", within=(0.0, 10.0))
    count: int = parameter(3, "How many", within=(1, 16))
    mode: str = parameter("up", "A way", choices=("up", "down"))
    quiet: bool = parameter(False, "Say less", fixed=True)
    weights: tuple[float, float] = parameter((1.0, 1.0), "Two weights", within=(0.0, 5.0))


@dataclass(frozen=True, kw_only=True)
class Other:
    more: float = parameter(1.0, "Another number", within=(0.0, 10.0))


@pytest.fixture
def context(ros_domain: int) -> Iterator[Context]:
    own = Context()
    own.init(args=[], domain_id=ros_domain)
    yield own
    own.try_shutdown()


def node_with(context: Context, **values: Any) -> Node:
    overrides = [Parameter(name, value=value) for name, value in values.items()]
    return Node("parameters", context=context, parameter_overrides=overrides)


def test_start_values_win_over_defaults(context: Context) -> None:
    node = node_with(context, gain=2.5, weights=[0.5, 2.0], quiet=True)
    assert declare(node, Settings(count=5)) == Settings(gain=2.5, count=5, weights=(0.5, 2.0), quiet=True)
    assert node.describe_parameter("gain").description == "A gain [1/s]"
    assert node.describe_parameter("gain").floating_point_range[0].to_value == 10.0
    assert node.describe_parameter("quiet").read_only
    node.destroy_node()


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("gain", "3", "parameter gain has the wrong type; allowed is a number from 0 to 10 1/s"),
        ("count", 3.5, "parameter count has the wrong type; allowed is a whole number from 1 to 16"),
        ("gain", 99.0, "parameter gain is refused; allowed is a number from 0 to 10"),
        ("gain", float("nan"), "parameter gain is refused"),
        ("count", 0, "parameter count is refused; allowed is a whole number from 1 to 16"),
        ("mode", "sideways", "parameter mode = 'sideways' is refused; allowed is one of: up, down"),
        ("quiet", "yes", "parameter quiet has the wrong type; allowed is true or false"),
        ("weights", [1.0], "allowed is 2 numbers from 0 to 5"),
        ("weights", [1.0, -1.0], "allowed is 2 numbers from 0 to 5"),
    ],
)
def test_a_wrong_start_value_is_one_sentence(context: Context, name: str, value: Any, words: str) -> None:
    node = node_with(context, **{name: value})
    with pytest.raises(ParameterError) as caught:
        declare(node, Settings())
    assert words in str(caught.value)
    node.destroy_node()


def test_a_name_that_is_not_declared_is_answered_with_the_nearest(context: Context) -> None:
    node = GuardedNode("parameters", context=context)
    declare(node, Settings())
    for name, words in (
        ("gian", "no parameter 'gian'; did you mean gain? known parameters: "),
        ("\x1b" * 999, "?"),
    ):
        result = node.set_parameters_atomically([Parameter("count", value=4), Parameter(name, value=1.0)])
        assert not result.successful
        assert words in result.reason
        assert result.reason.isprintable()
        assert len(result.reason) <= 300
        assert node.get_parameter("count").value == 3
    node.destroy_node()


def test_whole_numbers_are_numbers_at_the_start_and_later(context: Context) -> None:
    overrides = [Parameter("gain", value=3), Parameter("weights", value=[2, 1])]
    node = GuardedNode("parameters", context=context, parameter_overrides=overrides)
    other = LiveParameters(node, Other())
    parameters = LiveParameters(node, Settings())
    assert (parameters.values.gain, parameters.values.weights) == (3.0, (2.0, 1.0))
    for change in (Parameter("gain", value=4), Parameter("weights", value=[3, 4])):
        assert node.set_parameters_atomically([change]).successful
    assert (parameters.values.gain, parameters.values.weights) == (4.0, (3.0, 4.0))
    assert not node.set_parameters_atomically([Parameter("count", value=2.5)]).successful
    assert not node.set_parameters_atomically([Parameter("gain", value=True)]).successful
    assert node.set_parameters_atomically([Parameter("more", value=2)]).successful
    assert other.values.more == 2.0
    assert (node.get_parameter("gain").value, parameters.values.count) == (4.0, 3)
    node.destroy_node()


def test_a_change_happens_whole_or_not_at_all(context: Context) -> None:
    applied: list[tuple[frozenset[str], Settings]] = []

    def check(_: frozenset[str], values: Settings) -> None:
        if values.lowest > values.gain:
            raise CommandError("lowest is above gain")

    node = node_with(context)
    live = LiveParameters(node, Settings(), check=check, apply=lambda *change: applied.append(change))

    def set_together(**values: Any) -> tuple[bool, str]:
        changes = [Parameter(name, value=value) for name, value in values.items()]
        result = node.set_parameters_atomically(changes)
        return result.successful, result.reason

    for bad in ({"mode": "sideways"}, {"count": 99}, {"weights": [float("nan"), 1.0]}, {"quiet": True}):
        assert not set_together(gain=5.0, **bad)[0]
    assert set_together(gain=0.5, lowest=1.0) == (False, "lowest is above gain")
    assert (live.values, applied) == (Settings(), [])
    assert node.get_parameter("gain").value == 1.0
    assert set_together(gain=5.0, lowest=4.0) == (True, "")
    assert applied == [(frozenset({"gain", "lowest"}), Settings(gain=5.0, lowest=4.0))]
    live.store(gain=0.1)  # as it is already: neither checked nor applied
    assert (live.values.gain, len(applied)) == (0.1, 1)
    node.destroy_node()


def test_the_documented_commands_pass_the_parser_of_ros2_param_set() -> None:
    """It reads the value as YAML and makes a parameter of the type it finds; a mapping makes it fail."""
    found = 0
    for page in (REPOSITORY / "docs").rglob("*.md"):
        for line in re.findall(r"^ros2 param set .*$", page.read_text(), re.MULTILINE):
            words = shlex.split(line, comments=True)
            value = get_parameter_value(words[5])
            if words[4] == "overrides":
                found += 1
                assert value.type == ParameterType.PARAMETER_STRING
                assert read_overrides(value.string_value)["gravity"] == [0, 0, -1.6]
    assert found > 0


def test_help_tells_type_unit_range_default_and_what_is_fixed(capsys: pytest.CaptureFixture[str]) -> None:
    program = Program(name="trial", about="Tries.", settings=(Settings(),))
    with pytest.raises(SystemExit) as ended:
        program.options(["--help", "--ros-args", "-p", "gain:=2.0"])
    shown = capsys.readouterr().out
    assert ended.value.code == 0
    assert "gain: a number from 0 to 10 1/s; default 1.0" in shown
    assert "quiet: true or false; default false; fixed after the start" in shown


def test_a_word_that_is_no_option_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        Program(name="trial", about="Tries.").options(["gain:=2.0", "--ros-args", "-p", "gain:=2.0"])
    assert ended.value.code == 2
    assert "unrecognized arguments: gain:=2.0" in capsys.readouterr().err
