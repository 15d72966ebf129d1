"""What was measured, one record a scene, mesh and path; its JSON form and its verdict."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from softsim_core.file_writing import write_file
from softsim_ros.benchmark.touching import HELD_MS, LIMITS

HELD_LIMIT = 1.0 / 6.0
"""The held body's step costs at most this share of one SuperLU factorisation of its matrix."""

TRIPOD_LIMIT = 1.6
"""The full Tripod's step costs at most this many held-body steps on the same mesh."""


TICK_LIMIT = 3.0
"""A tick of inverse control costs at most this many steps of the Tripod on the same mesh."""


@dataclass
class Record:
    """One measured thing.

    Attributes:
        scene: "held_centre", "tripod", "inverse" (a tick of inverse control of the Tripod), or one of
            touching.SCENES.
        mesh: "low", "mid", "high" (ours) or "reference_low", ...
        path: "numba", "scipy" or a peer's name.
        nodes: Nodes of the mesh.
        elements: Tetrahedra of the mesh.
        min_ms: Shortest time in [ms] to advance the scene by its dt.
        median_ms: Median of that time in [ms].
        splu_min_ms: Shortest time in [ms] of one SuperLU factorisation of that step's matrix in the same run;
            None where there is none.
        extras: Further figures, written beside the others.
        ratio: What is judged, [-]; None: nothing.
        limit: The largest ratio that is right, [-].
        against: What the ratio compares with, for people.
        scipy_ratio: Shortest time over that of the SciPy path in the same run, [-]; None without it.
    """

    scene: str
    mesh: str
    path: str
    nodes: int
    elements: int
    min_ms: float
    median_ms: float
    splu_min_ms: float | None = None
    extras: dict[str, object] = field(default_factory=dict)
    ratio: float | None = None
    limit: float | None = None
    against: str = ""
    scipy_ratio: float | None = None

    @property
    def missed(self) -> bool:
        """Whether the ratio is over its limit."""
        return self.ratio is not None and self.limit is not None and not self.ratio <= self.limit

    def as_json(self) -> dict[str, object]:
        """The record as a JSON object: the eight fixed keys, then what else is known."""
        fixed: dict[str, object] = {
            "scene": self.scene,
            "mesh": self.mesh,
            "path": self.path,
            "nodes": self.nodes,
            "elements": self.elements,
            "min_ms": self.min_ms,
            "median_ms": self.median_ms,
            "splu_min_ms": self.splu_min_ms,
        }
        judged = {} if self.ratio is None else {"ratio": self.ratio, "limit": self.limit}
        compared = {} if self.scipy_ratio is None else {"scipy_ratio": self.scipy_ratio}
        return fixed | judged | compared | self.extras


def judge(records: Iterable[Record]) -> None:
    """Fill in the ratios that have a target, from the shortest times of one run."""
    records = list(records)
    tripod = {each.mesh: each for each in records if each.scene == "tripod" and each.path == "numba"}
    held = {each.mesh: each for each in records if each.scene == "held_centre" and each.path == "numba"}
    slow = {(each.scene, each.mesh): each for each in records if each.path == "scipy"}
    for record in records:
        if record.path != "numba":
            continue
        if (record.scene, record.mesh) in slow:
            record.scipy_ratio = record.min_ms / slow[record.scene, record.mesh].min_ms
        if record.scene == "held_centre" and record.splu_min_ms is not None:
            record.ratio, record.limit = record.min_ms / record.splu_min_ms, HELD_LIMIT
            record.against = "splu"
        elif record.scene == "tripod" and record.mesh in held:
            body = held[record.mesh]
            record.ratio, record.limit = record.min_ms / body.min_ms, TRIPOD_LIMIT
            record.extras["median_ratio"] = record.median_ms / body.median_ms
            record.against = "held"
        elif record.scene == "inverse" and record.mesh in tripod:
            step = tripod[record.mesh]
            record.ratio, record.limit = record.min_ms / step.min_ms, TICK_LIMIT
            record.extras["median_ratio"] = record.median_ms / step.median_ms
            record.against = "tripod"
        elif record.scene in LIMITS and record.mesh in held:
            record.ratio = record.min_ms / held[record.mesh].min_ms
            record.limit, record.against = LIMITS[record.scene] / HELD_MS, "held"


class Measured(Protocol):
    """Something measured that has a JSON form."""

    def as_json(self) -> dict[str, object]:
        """As a JSON object."""
        ...


def write_json(records: Iterable[Measured], file: Path) -> None:
    """Write the records as a list of objects.

    Raises:
        OSError: the file cannot be written.
    """
    write_file(file, json.dumps([record.as_json() for record in records], indent=1) + "\n")
