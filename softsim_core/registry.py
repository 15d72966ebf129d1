"""Names of the implementations of a seam: register, look up, list."""

from __future__ import annotations

from typing import Generic, Protocol, TypeVar

from softsim_core.errors import SceneError
from softsim_core.wrong_names import known_names


class Named(Protocol):
    """Anything with a name."""

    @property
    def name(self) -> str: ...  # noqa: D102


N = TypeVar("N", bound=Named)


class Registry(Generic[N]):
    """Implementations of one seam by name.

    Args:
        what: What they are, for messages: "linear solver".
        shipped: Those of the package; their names are taken.
    """

    def __init__(self, what: str, *shipped: N) -> None:
        self._what = what
        self._shipped = {each.name for each in shipped}
        self._known = {each.name: each for each in shipped}

    def register(self, new: N) -> None:
        """Make `new` known by its name; one that a scene file registered before is replaced.

        Raises:
            SceneError: the name is one of the package's own.
        """
        if new.name in self._shipped:
            raise SceneError(f"{self._what} {new.name!r} is the package's own; choose another name for yours")
        self._known[new.name] = new

    def get(self, name: str) -> N:
        """The one of that name.

        Raises:
            SceneError: there is none; the sentence lists those that are known.
        """
        if name not in self._known:
            raise SceneError(f"unknown {self._what} {name!r}; {known_names(name, self._known)}")
        return self._known[name]

    def names(self) -> tuple[str, ...]:
        """All known names, the package's own first."""
        return tuple(self._known)
