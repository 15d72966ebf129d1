"""What a request over simulation_interfaces is refused with."""

from __future__ import annotations

from softsim_core.errors import SoftSimError


class RequestError(SoftSimError):
    """A request that is answered with another result than OK.

    Args:
        kind: Name of the result, such as "NOT_FOUND", or of one of the service's own.
        sentence: Why.
    """

    def __init__(self, kind: str, sentence: str) -> None:
        self.kind = kind
        super().__init__(sentence)
