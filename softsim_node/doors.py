"""Where messages, requests and parameters come in: what fails there becomes one sentence, the node lives."""

from __future__ import annotations

import functools
import inspect
import time
from collections.abc import Callable
from typing import Any, Final

from rcl_interfaces.msg import SetParametersResult

from softsim_node.sentences import one_line, sentence_of

REFUSAL_PERIOD_S: Final = 1.0
"""Refusals that begin alike are said at most this often, in [s]."""

HEAD: Final = 30
"""Refusals are alike whose first characters, so many, are the same."""

MOST_KINDS: Final = 10
"""So many different refusals are said in one period."""

Guarded = Callable[..., Any]


class Refusals:
    """Says why something was refused; sentences that begin alike at most once a period.

    Args:
        say: Gets each sentence, on one line and cut.
        clock: Steady clock in [s].
    """

    def __init__(self, say: Callable[[str], object], clock: Callable[[], float] = time.monotonic) -> None:
        self._say, self._clock = say, clock
        self._said_at: dict[str, float] = {}

    def tell(self, sentence: str) -> None:
        """Say a sentence, unless one like it was said just now."""
        line, now = one_line(sentence), self._clock()
        self._said_at = {head: at for head, at in self._said_at.items() if now - at < REFUSAL_PERIOD_S}
        if line[:HEAD] not in self._said_at and len(self._said_at) < MOST_KINDS:
            self._said_at[line[:HEAD]] = now
            self._say(line)


def message_door(callback: Guarded, refuse: Callable[[str], None], topic: str) -> Guarded:
    """A topic's callback whose failure is told to `refuse` in a sentence."""

    @functools.wraps(callback)
    def receive(*arguments: Any) -> None:
        try:
            callback(*arguments)
        except Exception as error:
            refuse(f"message on {topic} {sentence_of(error)}")

    return receive


def service_door(callback: Guarded, refuse: Callable[[str], None], service: str) -> Guarded:
    """A service's callback that answers with the sentence of its failure; long answers are cut.

    A callback that is a coroutine stays one.
    """

    def refused(response: Any, error: Exception) -> Any:
        sentence = sentence_of(error)
        refuse(f"request to {service} {sentence}")
        if hasattr(response, "success") and hasattr(response, "message"):
            response.success, response.message = False, sentence
        return response

    def bounded(response: Any) -> Any:
        if isinstance(getattr(response, "message", None), str):
            response.message = one_line(response.message)
        return response

    @functools.wraps(callback)
    def answer(request: Any, response: Any) -> Any:
        try:
            return bounded(callback(request, response))
        except Exception as error:
            return refused(response, error)

    @functools.wraps(callback)
    async def answer_later(request: Any, response: Any) -> Any:
        try:
            return bounded(await callback(request, response))
        except Exception as error:
            return refused(response, error)

    return answer_later if inspect.iscoroutinefunction(callback) else answer


def parameter_door(callback: Guarded, refuse: Callable[[str], None]) -> Guarded:
    """A callback for new parameters that refuses them with the sentence of its failure; long ones are cut."""

    @functools.wraps(callback)
    def decide(parameters: Any) -> SetParametersResult:
        try:
            result: SetParametersResult = callback(parameters)
        except Exception as error:
            result = SetParametersResult(successful=False, reason=sentence_of(error))
            refuse(f"parameters {result.reason}")
        result.reason = one_line(result.reason)
        return result

    return decide
