"""Make docs/pictures/badges.svg from what the checkout declares: version, Python, ROS 2, licence.

From the checkout: `.softsim/venv/bin/python docs/pictures/badges.py`.
"""

from __future__ import annotations

import re
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
REPOSITORY = FOLDER.parents[1]
CHARACTER, PADDING, HEIGHT, GAP = 6.6, 8, 20, 6
COLOURS = ("#d65f34", "#2f6db0", "#22314e", "#4b7f52")


def facts() -> list[tuple[str, str]]:
    """What each badge says."""
    project = (REPOSITORY / "pyproject.toml").read_text(encoding="utf-8")
    core = (REPOSITORY / "softsim_core" / "__init__.py").read_text(encoding="utf-8")

    def found(pattern: str, text: str) -> str:
        match = re.search(pattern, text, re.MULTILINE)
        assert match is not None, pattern
        return match[1]

    pythons = re.findall(r"Python :: (3\.\d+)", project)
    return [
        ("softsim", found(r'^__version__ = "(.+)"', core)),
        ("Python", f"{pythons[0]} to {pythons[-1]}"),
        ("ROS 2", found(r'"ros-(\w+)-rclpy', project).capitalize()),
        ("licence", found(r'^license = "(.+)"', project)),
    ]


def picture() -> str:
    """The badges in a row, as SVG."""
    parts, left = [], 0.0
    for (name, value), colour in zip(facts(), COLOURS, strict=True):
        first, second = (len(text) * CHARACTER + 2 * PADDING for text in (name, value))
        parts += [
            f'<rect x="{left:.1f}" width="{first + second:.1f}" height="{HEIGHT}" rx="4" fill="#444d56"/>',
            f'<path d="M{left + first:.1f} 0h{second - 4:.1f}a4 4 0 0 1 4 4v12a4 4 0 0 1-4 4'
            f'h-{second - 4:.1f}z" fill="{colour}"/>',
            f'<text x="{left + first / 2:.1f}" y="14">{name}</text>',
            f'<text x="{left + first + second / 2:.1f}" y="14">{value}</text>',
        ]
        left += first + second + GAP
    width = left - GAP
    label = ", ".join(" ".join(fact) for fact in facts())
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{HEIGHT}" '
        f'viewBox="0 0 {width:.1f} {HEIGHT}" '
        f'role="img" aria-label="{label}" font-family="Verdana, DejaVu Sans, sans-serif" font-size="11" '
        'fill="#fff" text-anchor="middle">'
    )
    return "\n".join([head, *parts, "</svg>"]) + "\n"


if __name__ == "__main__":
    (FOLDER / "badges.svg").write_text(picture(), encoding="utf-8")
