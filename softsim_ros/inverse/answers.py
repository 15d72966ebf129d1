"""Service callbacks from plain functions: the sentence they return, or that of the error they raise."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from std_srvs.srv import SetBool, Trigger

from softsim_core.errors import SoftSimError


def trigger(action: Callable[[], str]) -> Callable[[Trigger.Request, Trigger.Response], Trigger.Response]:
    """Callback of a Trigger service; an error of the suite comes back as success = false."""

    def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return _filled(response, action)

    return answer


def switch(action: Callable[[bool], str]) -> Callable[[SetBool.Request, SetBool.Response], SetBool.Response]:
    """Callback of a SetBool service; an error of the suite comes back as success = false."""

    def answer(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        return _filled(response, lambda: action(bool(request.data)))

    return answer


def _filled(response: Any, action: Callable[[], str]) -> Any:
    try:
        response.success, response.message = True, action()
    except SoftSimError as error:
        response.success, response.message = False, str(error)
    return response
