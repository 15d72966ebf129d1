"""Answers of services that do one thing and say what they did, or why not."""

from __future__ import annotations

from collections.abc import Callable

from std_srvs.srv import Trigger

from softsim_core.errors import SoftSimError


def attempt(action: Callable[[], str]) -> tuple[bool, str]:
    """Success and sentence of a service call."""
    try:
        return True, action()
    except SoftSimError as error:
        return False, str(error)


def answering(
    action: Callable[[], str],
) -> Callable[[Trigger.Request, Trigger.Response], Trigger.Response]:
    """A callback that does `action` and answers with its sentence."""

    def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = attempt(action)
        return response

    return answer
