"""Parameters of a node from one dataclass: declared, checked and applied as a whole; the text of --help."""

from __future__ import annotations

import argparse
import dataclasses
import math
import textwrap
from array import array
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain
from typing import Any, Final, Generic, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.utilities import remove_ros_args

from softsim_core.base import SoftSimError, listing
from softsim_node.text import error_message, one_line

_KEY: Final = "parameter"
_SHOWN: Final = 40


class ParameterError(SoftSimError, ValueError):
    """A parameter's value has the wrong type, lies outside its range, or does not fit the other values."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterInfo:
    """Description of a parameter, and what values it allows.

    Attributes:
        text: One sentence of description.
        unit: Unit of a number; empty if it has none.
        within: Smallest and largest allowed number; None for other types.
        choices: Allowed texts; empty allows any.
        fixed: Whether it cannot change after the start.
        count: Length of a list of numbers; None for other types.
    """

    text: str
    unit: str = ""
    within: tuple[float, float] | None = None
    choices: tuple[str, ...] = ()
    fixed: bool = False
    count: int | None = None

    @property
    def description(self) -> str:
        """The description with the unit, as `ros2 param describe` shows it."""
        return f"{self.text} [{self.unit}]" if self.unit else self.text

    def describe_allowed(self, default: object) -> str:
        """Return the allowed values in words; `default` gives the type."""
        if isinstance(default, bool):
            return "true or false"
        if isinstance(default, str):
            return f"one of: {listing(self.choices)}" if self.choices else "a text"
        lower, upper = self.within or (-math.inf, math.inf)
        unit = f" {self.unit}" if self.unit else ""
        if isinstance(default, int):
            return f"a whole number from {lower:g} to {upper:g}{unit}"
        if isinstance(default, float):
            return f"a number from {lower:g} to {upper:g}{unit}"
        return f"{self.count} numbers from {lower:g} to {upper:g}{unit}: [1.0, ...]"


def parameter(
    default: Any,
    text: str,
    *,
    unit: str = "",
    within: tuple[float, float] | None = None,
    choices: Sequence[str] = (),
    fixed: bool = False,
) -> Any:
    """Return a dataclass field for the parameter with the field's name; see ParameterInfo.

    `default` gives its type: boolean, whole number, number, text, or a tuple of numbers. Every number needs
    `within`.
    """
    count = len(default) if isinstance(default, tuple) else None
    about = ParameterInfo(
        text=text, unit=unit, within=within, choices=tuple(choices), fixed=fixed, count=count
    )
    return dataclasses.field(default=default, metadata={_KEY: about})


def parameters_of(settings: Any) -> Iterator[tuple[str, object, ParameterInfo]]:
    """Yield name, value and description of each parameter of a dataclass instance, in its order."""
    for field in dataclasses.fields(settings):
        yield field.name, getattr(settings, field.name), field.metadata[_KEY]


Settings = TypeVar("Settings")


def declare(node: Node, settings: Settings) -> Settings:
    """Declare the parameters of `settings` with its values as defaults; declared ones are unchanged.

    Returns:
        The values that the parameters have at the start.

    Raises:
        ParameterError: a value given at the start is not allowed.
    """
    values = {
        name: declare_value(node, name, default, about) for name, default, about in parameters_of(settings)
    }
    return dataclasses.replace(settings, **values)  # type: ignore[type-var]


def declare_value(
    node: Node, name: str, default: Any, about: ParameterInfo, *, overridable: bool = True
) -> Any:
    """Declare a parameter with a name or range that is known only at run time; return its value.

    Args:
        node: Node of the parameter.
        name: Name of the parameter.
        default: Value of the parameter if none is given.
        about: Description and allowed values.
        overridable: Whether a value given at the start of the node is used.

    Raises:
        ParameterError: the value given at the start is not allowed.
    """
    if node.has_parameter(name):
        return check_value(name, node.get_parameter(name).value, default, about)
    first = list(default) if isinstance(default, tuple) else default
    allowed = about.describe_allowed(default)
    descriptor = _descriptor(default, about)
    try:
        if overridable and isinstance(default, float | tuple):
            of_any_type = ParameterDescriptor(dynamic_typing=True)
            found = node.declare_parameter(name, first, of_any_type).value
            node.undeclare_parameter(name)
            if (number := with_decimals(found)) is not found:
                first, overridable = number, False
        value = node.declare_parameter(name, first, descriptor, ignore_override=not overridable).value
    except InvalidParameterTypeException as error:
        raise ParameterError(f"parameter {name} has the wrong type; allowed is {allowed}") from error
    except InvalidParameterValueException as error:
        raise ParameterError(f"parameter {name} is refused; allowed is {allowed}") from error
    return check_value(name, value, default, about)


@contextmanager
def parameter_probe(
    name: str, *, parameter_overrides: Sequence[Parameter] | None = None, **node_options: Any
) -> Iterator[Node]:
    """Create a temporary node to read the parameters from which the real node is made.

    Use it only before the real node exists: when a node ends, the graph drops every node with its name.

    Args:
        name: Name of the real node.
        parameter_overrides: Values at the start, which override those of the command line.
        **node_options: Passed on to rclpy's Node.
    """
    no_service = Parameter("start_type_description_service", value=False)  # Fast DDS has hung in its end
    node = Node(
        name,
        parameter_overrides=[*(parameter_overrides or ()), no_service],
        start_parameter_services=False,
        enable_rosout=False,
        enable_logger_service=False,
        **node_options,
    )
    try:
        yield node
    finally:
        node.destroy_node()


def check_value(name: str, value: Any, default: Any, about: ParameterInfo) -> Any:
    """Return a parameter's value in the type of the dataclass, after a check.

    Args:
        name: Name of the parameter.
        value: Value from rclpy, of the right type.
        default: A value of the same type.
        about: Description and allowed values.

    Raises:
        ParameterError: the value is not allowed.
    """
    numbers: list[float] = []
    if isinstance(default, tuple):
        value = tuple(map(float, value))
        numbers = list(value)
    elif isinstance(default, float):
        numbers = [float(value)]
    lower, upper = about.within or (-math.inf, math.inf)
    fits = all(lower <= number <= upper and math.isfinite(number) for number in numbers)  # NaN does not
    if about.choices:
        fits = value in about.choices
    if about.count is not None:
        fits = fits and len(numbers) == about.count
    if not fits:
        shown = one_line(repr(value)[:_SHOWN])
        raise ParameterError(
            f"parameter {name} = {shown} is refused; allowed is {about.describe_allowed(default)}"
        )
    return value


class ParameterChanges:
    """Base of what checks changes of parameters as a whole, and applies them once they are stored."""

    def __init__(self, node: Node) -> None:
        self._node, self._is_quiet = node, False
        node.add_on_set_parameters_callback(self._on_set)
        node.add_post_set_parameters_callback(self._post_set)

    def store(self, **values: object) -> None:
        """Set parameters to values that apply already; nothing is checked or applied."""
        with self._quietly():
            self._node.set_parameters([Parameter(name, value=value) for name, value in values.items()])

    @contextmanager
    def _quietly(self) -> Iterator[None]:
        """Neither check nor apply changes inside."""
        self._is_quiet = True
        try:
            yield
        finally:
            self._is_quiet = False

    def _on_set(self, changes: list[Parameter]) -> SetParametersResult:
        try:
            self._check_changes(changes)
        except Exception as error:
            return SetParametersResult(successful=False, reason=error_message(error))
        return SetParametersResult(successful=True)

    def _check_changes(self, changes: Sequence[Parameter]) -> None:
        """Raise if changes are not allowed."""
        raise NotImplementedError

    def _post_set(self, changes: list[Parameter]) -> None:
        """Apply changes that are stored already."""
        raise NotImplementedError


class LiveParameters(ParameterChanges, Generic[Settings]):
    """The declared parameters of a node and their present values.

    A change is checked as a whole before any value of it is stored, and applied as a whole afterwards.

    Args:
        settings: Defaults; see `declare`.
        check: Receives the names that are set and all values after the change; raises if they are not
            allowed.
        apply: Receives the same once the values are stored.

    Attributes:
        values: Present values; inside `check` the ones before the change.

    Raises:
        ParameterError: a value given at the start is not allowed.
    """

    def __init__(
        self,
        node: Node,
        settings: Settings,
        *,
        check: Callable[[frozenset[str], Settings], object] = lambda names, values: None,
        apply: Callable[[frozenset[str], Settings], object] = lambda names, values: None,
    ) -> None:
        self.values = declare(node, settings)
        self._check, self._apply = check, apply
        self._about = {name: (default, about) for name, default, about in parameters_of(self.values)}
        super().__init__(node)

    def _merge_changes(self, changes: Sequence[Parameter]) -> tuple[frozenset[str], Settings]:
        values = {
            change.name: check_value(change.name, change.value, *self._about[change.name])
            for change in changes
            if change.name in self._about
        }
        return frozenset(values), dataclasses.replace(self.values, **values)  # type: ignore[type-var]

    def _check_changes(self, changes: Sequence[Parameter]) -> None:
        names, values = self._merge_changes(changes)
        if names and not self._is_quiet:
            self._check(names, values)

    def _post_set(self, changes: list[Parameter]) -> None:
        names, self.values = self._merge_changes(changes)
        if names and not self._is_quiet:
            try:
                self._apply(names, self.values)
            except Exception as error:  # rclpy has stored the values and has no answer for this
                self._node.get_logger().error(f"parameters are stored, but: {error_message(error)}")


def with_decimals(value: Any) -> Any:
    """Return whole numbers, alone or in a list, as floating-point numbers; other values unchanged."""
    if type(value) is int:
        return float(value)
    if isinstance(value, list | array) and len(value) and all(type(each) is int for each in value):
        return [float(each) for each in value]
    return value


def _descriptor(default: object, about: ParameterInfo) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(
        description=about.description,
        additional_constraints=about.describe_allowed(default) if about.choices or about.count else "",
        read_only=about.fixed,
    )
    if about.within is not None and isinstance(default, float):
        lower, upper = map(float, about.within)
        descriptor.floating_point_range = [FloatingPointRange(from_value=lower, to_value=upper, step=0.0)]
    elif about.within is not None and isinstance(default, int) and not isinstance(default, bool):
        first, last = map(int, about.within)
        descriptor.integer_range = [IntegerRange(from_value=first, to_value=last, step=1)]
    return descriptor


_WIDTH = 100


@dataclass(frozen=True)
class Program:
    """A node as a program.

    Attributes:
        name: Name of the executable.
        about: Purpose of the program, as one sentence.
        settings: Its parameters: instances of dataclasses, see `softsim_node.parameters`.
        more: A sentence about parameters that depend on the robot; empty: there are none.
        configure: Adds options of the program; all are optional.
    """

    name: str
    about: str
    settings: tuple[object, ...] = ()
    more: str = ""
    configure: Callable[[argparse.ArgumentParser], None] = lambda parser: None

    def options(self, words: Sequence[str]) -> argparse.Namespace:
        """Parse the program's own options on a command line; those of ROS are left out.

        Args:
            words: Command line without the program's name.

        Raises:
            SystemExit: after `--help` (0), or for words it does not know (2); both have been printed.
        """
        parser = argparse.ArgumentParser(
            prog=self.name,
            description=self.about,
            epilog=self._parameters(),
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
            usage="%(prog)s [-h] [options] [--ros-args -p NAME:=VALUE -r __ns:=/NAMESPACE ...]",
        )
        self.configure(parser)
        return parser.parse_args(remove_ros_args([self.name, *words])[1:])

    def _parameters(self) -> str:
        lines = ["parameters, each given as --ros-args -p NAME:=VALUE:"]
        for name, default, about in chain.from_iterable(map(parameters_of, self.settings)):
            shown = str(default).lower() if isinstance(default, bool) else str(default) or "empty"
            fixed = "; fixed after the start" if about.fixed else ""
            lines.append(f"  {name}: {about.describe_allowed(default)}; default {shown}{fixed}")
            lines += textwrap.wrap(about.text, _WIDTH, initial_indent="      ", subsequent_indent="      ")
        if self.more:
            lines += textwrap.wrap(self.more, _WIDTH, initial_indent="  ", subsequent_indent="  ")
        return "\n".join(lines)
