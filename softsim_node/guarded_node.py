"""A node that outlives whatever is sent to it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.executors import ExternalShutdownException, ShutdownException
from rclpy.node import Node
from rclpy.parameter import Parameter

from softsim_core.scene.catalog import shortened
from softsim_core.wrong_names import known_names
from softsim_node import doors
from softsim_node.parameters import with_decimals
from softsim_node.sentences import one_line, sentence_of


class GuardedNode(Node):
    """A node whose callbacks of topics, services and new parameters stand behind doors.

    Those of rclpy's own parameter services, too. See `softsim_node.doors`.
    """

    def refuse(self, sentence: str) -> None:
        """Log why something that came from outside was not obeyed."""
        if self.context.ok():
            self._refusals.tell(sentence)

    @cached_property
    def _refusals(self) -> doors.Refusals:
        return doors.Refusals(self.get_logger().warning)

    @contextmanager
    def refusing(self, what: str) -> Iterator[None]:
        """Log in a sentence what fails inside, and go on; `what` was being done."""
        try:
            yield
        except (ExternalShutdownException, ShutdownException):
            raise
        except Exception as error:
            if not self.context.ok():
                raise
            self.refuse(f"{what} {sentence_of(error)}")

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Any, *args: Any, **options: Any
    ) -> Any:
        """As rclpy's; a message that `callback` cannot take is refused in a sentence."""
        behind = doors.message_door(callback, self.refuse, topic)
        return super().create_subscription(msg_type, topic, behind, *args, **options)

    def create_service(self, srv_type: Any, srv_name: str, callback: Any, **options: Any) -> Any:
        """As rclpy's; a request that `callback` cannot serve is answered with a sentence."""
        behind = doors.service_door(callback, self.refuse, srv_name)
        return super().create_service(srv_type, srv_name, behind, **options)

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """As rclpy's; a name that is not declared is refused with a message that lists the nearest ones.

        Whole numbers are taken where numbers are declared: `2` for `2.0`.
        """
        for each in parameter_list:
            if not self.has_parameter(each.name):
                names = sorted(self.get_parameters_by_prefix(""))
                known = known_names(shortened(each.name), names, "known parameters:")
                return SetParametersResult(reason=one_line(f"no parameter {shortened(each.name)!r}; {known}"))
        return super().set_parameters_atomically([self._as_declared(each) for each in parameter_list])

    def _as_declared(self, given: Parameter) -> Parameter:
        number = with_decimals(given.value)
        declared = self.get_parameter_or(given.name).type_
        takes = declared in (Parameter.Type.DOUBLE, Parameter.Type.DOUBLE_ARRAY)
        return Parameter(given.name, value=number) if takes and number is not given.value else given

    def add_on_set_parameters_callback(self, callback: Any) -> None:
        """As rclpy's; parameters that `callback` cannot take are refused with a sentence."""
        super().add_on_set_parameters_callback(doors.parameter_door(callback, self.refuse))
