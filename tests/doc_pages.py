"""What the pages of the documentation hold: fences, their markers, links."""

from __future__ import annotations

import argparse
import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
DOCS = REPOSITORY / "docs"
TUTORIALS = DOCS / "tutorials"
TUTORIAL_PAGES = sorted(TUTORIALS.rglob("*.md"))
README = REPOSITORY / "README.md"
PAGES = [README, REPOSITORY / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]
QUICK_START = "## Two commands"

_FENCE = re.compile(
    r"(?:^ *<!-- (?:test: (?P<flags>.*?)|lines of (?P<source>\S+)|not run: (?P<reason>.*?)) -->\n)?"
    r"^ *```(?P<language>\w*)\n(?P<body>.*?)^ *```$",
    re.MULTILINE | re.DOTALL,
)
_LINK = re.compile(r"\]\(([^)\s]+)\)")
_HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)


@dataclass(frozen=True)
class Fence:
    """A fenced block of a page.

    Attributes:
        page: The page.
        language: The word behind the backticks.
        body: Its lines.
        flags: Of `<!-- test: FLAGS -->` before it: its command is started for real, these flags added.
        source: Of `<!-- lines of PATH -->` before it: the file that its lines are taken from.
        reason: Of `<!-- not run: REASON -->` before it: why no test runs it.
    """

    page: Path
    language: str
    body: str
    flags: str | None
    source: Path | None
    reason: str | None = None

    def __str__(self) -> str:
        return f"{self.page.stem}: {self.body.splitlines()[0].strip()[:60]}"


def fences(page: Path, section: str | None = None) -> Iterator[Fence]:
    """The fenced blocks of a page, or of one section of it."""
    text = page.read_text(encoding="utf-8")
    if section is not None:
        text = text.split(section, 1)[1].split("\n## ", 1)[0]
    for match in _FENCE.finditer(text):
        source = match["source"]
        yield Fence(
            page,
            match["language"],
            match["body"],
            match["flags"],
            None if source is None else (page.parent / source).resolve(),
            match["reason"],
        )


def commands(fence: Fence) -> Iterator[list[str]]:
    """The command lines of a block as words, without comments; of a transcript, the lines behind `$`."""
    lines = fence.body.replace("\\\n", " ").splitlines()
    if any(line.startswith("$ ") for line in lines):
        lines = [line.removeprefix("$ ") for line in lines if line.startswith("$ ")]
    for line in lines:
        words = shlex.split(line, comments=True)
        if words:
            yield words


def parsed_command(name: str, words: list[str]) -> argparse.Namespace:
    """The command line of a subcommand of `softsim` as the program reads it; unknown options end the test."""
    from softsim_ros.cli import COMMANDS

    assert name in COMMANDS, f"unknown command {name}"
    parser = argparse.ArgumentParser(prog=name, allow_abbrev=False)
    COMMANDS[name].import_module().configure(parser)
    return parser.parse_args(words)


def code_lines(text: str) -> list[str]:
    """Lines without what stands before and after the code, in YAML and Python."""
    return [line.split("  #")[0].strip() for line in text.splitlines()]


def links(page: Path) -> Iterator[str]:
    """Targets of links and pictures outside of fenced blocks, but for those in the web."""
    text = _FENCE.sub("", page.read_text(encoding="utf-8"))
    yield from (target for target in _LINK.findall(text) if "://" not in target)


def anchors(page: Path) -> set[str]:
    """What a link may name behind `#`: the headings, as GitHub spells them."""
    headings = _HEADING.findall(_FENCE.sub("", page.read_text(encoding="utf-8")))
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}
