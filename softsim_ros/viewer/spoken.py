"""The newest sentence for the person at the page."""

from __future__ import annotations


class Spoken:
    """The newest sentence for the person.

    Attributes:
        sentence: Empty: nothing was said.
    """

    def __init__(self) -> None:
        self.sentence = ""

    def say(self, sentence: str) -> None:
        """Show one sentence."""
        self.sentence = sentence
