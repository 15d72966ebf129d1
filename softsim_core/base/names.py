"""Names of implementations: registration, lookup, and suggestions for a wrong name."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Generic, Protocol, TypeVar

from softsim_core.base.errors import SceneError, listing

MOST_PROPOSED = 5
MOST_LISTED = 12
"""Largest number of known names in a message; of more names it gives the nearest, or the first few."""

_ALIKE = 0.55
_NEARLY_AS_ALIKE = 0.1
"""A suggestion may be less similar than the best one by this, of 1."""

LONGEST_NAME = 60
"""Largest number of characters of a name in a message."""

MOST_NAMES = 10
"""Largest number of names that come from elsewhere in a message."""


def nearest(unknown: object, names: Iterable[object]) -> list[str]:
    """Return the most similar names, best first: those with the same beginning, then those spelt alike.

    Case, blanks, hyphens, underscores and dots do not count.
    """
    return [name for _, name in _rank_names(unknown, names)]


def _rank_names(unknown: object, names: Iterable[object]) -> list[tuple[float, str]]:
    """Return the nearest names with their similarity, up to 1; more for names with the same beginning."""
    plain = _plain(str(unknown)[:LONGEST_NAME])
    table: dict[str, str] = {}
    for name in map(str, names):
        table.setdefault(_plain(name), name)
    if not plain:
        return []
    ranks = {each: 1.0 + 1.0 / len(each) for each in table if each.startswith(plain)}
    matcher = difflib.SequenceMatcher(b=plain)
    most_alike = 0.0
    for each in difflib.get_close_matches(plain, table, MOST_PROPOSED, _ALIKE):  # the best first
        matcher.set_seq1(each)
        ratio = matcher.ratio()
        most_alike = max(most_alike, ratio)
        if ratio >= most_alike - _NEARLY_AS_ALIKE:
            ranks.setdefault(each, ratio)
    best = sorted(ranks, key=lambda each: (-ranks[each], each))[:MOST_PROPOSED]
    return [(ranks[each], table[each]) for each in best]


def did_you_mean(unknown: object, names: Iterable[object]) -> str:
    """Return the question "did you mean tripod or tripod_mid?"; empty if no name is near."""
    near = nearest(unknown, names)
    if len(near) > 1:
        near = [", ".join(near[:-1]), near[-1]]
    return f"did you mean {' or '.join(near)}?" if near else ""


def _best_of_few(unknown: object, names: Iterable[object]) -> str:
    """Return the question for a single nearest name, for a message that also lists all names."""
    ranked = _rank_names(unknown, names)
    alone = len(ranked) == 1 or (len(ranked) > 1 and ranked[0][0] > ranked[1][0])
    return f"did you mean {ranked[0][1]}?" if alone else ""


def known_names(
    unknown: object,
    names: Iterable[object],
    heading: str = "known:",
    *,
    lists_all: str = "",
    whole: bool = False,
) -> str:
    """Return the second half of an error message: suggestions and known names.

    Args:
        unknown: The unknown name.
        names: The known names.
        heading: Text before the list: "known joints:".
        lists_all: Command that lists all of them, for more than MOST_LISTED.
        whole: List all names, because no other command does.
    """
    every = list(map(str, names))
    if whole or len(every) <= MOST_LISTED:
        return f"{_best_of_few(unknown, every)} {heading} {listing(every)}".lstrip()
    more = f"{heading} {listing(every[:MOST_PROPOSED])} and {len(every) - MOST_PROPOSED} more"
    return (did_you_mean(unknown, every) or more) + (f" (all: {lists_all})" if lists_all else "")


def one_of(unknown: object, names: Iterable[object]) -> str:
    """Return the allowed words for a wrong one: "one of tet4, tet10 (did you mean tet4?)"."""
    every = list(map(str, names))
    question = _best_of_few(unknown, every)
    return f"one of {listing(every)}" + (f" ({question})" if question else "")


def on_one_line(text: str) -> str:
    """Return text without line breaks and other characters that are not printable."""
    return "".join(each if each.isprintable() else " " for each in text)


def shorten(text: str, most: int = LONGEST_NAME) -> str:
    """Return foreign text for a message: without control characters, of at most `most` characters."""
    plain = "".join(each if each.isprintable() else "?" for each in text[: most + 1])
    return plain if len(plain) <= most else f"{plain[: most - 3]}..."


def names_up_to(most: int, names: Iterable[str], longest: int = LONGEST_NAME) -> str:
    """Return names for a message: the first ones, shortened, and the number of further ones."""
    every = list(names)
    more = f" and {len(every) - most} more" if len(every) > most else ""
    return f"{listing(shorten(name, longest) for name in every[:most])}{more}"


def _plain(name: str) -> str:
    return "".join(each for each in name.casefold() if each not in " -_.")


class Named(Protocol):
    """Any object with a name."""

    @property
    def name(self) -> str: ...  # noqa: D102


N = TypeVar("N", bound=Named)


class Registry(Generic[N]):
    """Registry of the implementations of one interface ("linear solver" in messages) by name.

    The names of the shipped implementations are reserved.
    """

    def __init__(self, what: str, *shipped: N) -> None:
        self._what = what
        self._shipped = {each.name for each in shipped}
        self._registered = {each.name: each for each in shipped}

    def register(self, new: N) -> None:
        """Register `new` by its name, replacing one that a scene file registered before.

        Raises:
            SceneError: the name is one of the package's own.
        """
        if new.name in self._shipped:
            raise SceneError(f"{self._what} {new.name!r} is the package's own; choose another name for yours")
        self._registered[new.name] = new

    def get(self, name: str) -> N:
        """Return the implementation of that name.

        Raises:
            SceneError: there is none; the message lists the known ones.
        """
        if name not in self._registered:
            raise SceneError(f"unknown {self._what} {name!r}; {known_names(name, self._registered)}")
        return self._registered[name]

    def names(self) -> tuple[str, ...]:
        """Return all known names, the package's own first."""
        return tuple(self._registered)
