"""What an error says to a person: one line, bounded, nothing in it that a terminal would obey."""

from __future__ import annotations

from typing import Final

from softsim_core.errors import SoftSimError

LONGEST_SENTENCE: Final = 300
"""So many characters has a refusal at most, on the log and in an answer."""


def sentence_of(error: BaseException) -> str:
    """What an error says to a person, on one line of at most LONGEST_SENTENCE characters."""
    text = str(error)
    if not isinstance(error, SoftSimError):
        text = f"refused: {type(error).__name__}" + (f" ({text})" if text else "")
    return one_line(text)


def one_line(text: str) -> str:
    """Text of others for logs and answers: control characters replaced, cut to LONGEST_SENTENCE."""
    head = text[: LONGEST_SENTENCE + 1]
    plain = head if head.isprintable() else "".join(c if c.isprintable() else " " for c in head)
    return plain if len(plain) <= LONGEST_SENTENCE else f"{plain[: LONGEST_SENTENCE - 3]}..."
