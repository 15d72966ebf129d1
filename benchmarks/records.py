"""Measurements: one record per scene, mesh and path; JSON, verdict, table."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from benchmarks.measured_scenes import CLAMPED_MS, LIMITS
from softsim_core.base import write_file

_SILICONE = {"low": (235, 579), "mid": (781, 2684), "high": (1455, 5221)}
_FINGER = (158, 389)
_FINGERS = {"cable_finger": 1, "gripper_free": 3, "gripper_grasp": 3}


def reference_size(scene: str, mesh: str) -> tuple[int, int]:
    """Return nodes and tetrahedra of a benchmark scene on the reference's mesh of the same level."""
    if scene in _FINGERS:
        return _FINGERS[scene] * _FINGER[0], _FINGERS[scene] * _FINGER[1]
    return _SILICONE[mesh.removeprefix("reference_")]


CLAMPED_LIMIT = 1.0 / 6.0
"""Largest cost of the clamped body's step, in SuperLU factorisations of its matrix."""

PROBE_LIMITS = {"low": 0.55, "mid": 1.7, "high": 7.6}
"""Largest cost of the clamped body's step on a mesh, or on the reference's of that level, in probes."""

TRIPOD_LIMIT = 1.6
"""Largest cost of the full Tripod's step, in steps of the clamped body on the same mesh."""


TICK_LIMIT = 3.0
"""Largest cost of a tick of inverse control, in steps of the Tripod on the same mesh."""


@dataclass
class Record:
    """One measurement.

    Attributes:
        scene: "held_centre", "tripod", "inverse" (a tick of inverse control of the Tripod), or one of
            cases.TOUCHING.
        mesh: "low", "mid", "high" (ours) or "reference_low", ...
        path: "numba", "scipy" or a peer's name.
        nodes: Nodes of the mesh.
        elements: Tetrahedra of the mesh.
        min_ms: Shortest time in [ms] to advance the scene by its dt.
        median_ms: Median of that time in [ms].
        splu_min_ms: Shortest time in [ms] of one SuperLU factorisation of that step's matrix in the same run;
            None if there is none.
        probe_min_ms: Shortest time in [ms] of the probe in the same run; None if it did not run.
        extras: Further figures, written with the others.
        ratio: Ratio to compare with the limit, [-]; None if there is none.
        limit: Largest allowed ratio, [-].
        against: Description of what the ratio refers to.
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
    probe_min_ms: float | None = None
    extras: dict[str, object] = field(default_factory=dict)
    ratio: float | None = None
    limit: float | None = None
    against: str = ""
    scipy_ratio: float | None = None

    @property
    def probe_ratio(self) -> float | None:
        """Shortest time over that of the probe, [-]; None without it."""
        return None if self.probe_min_ms is None else self.min_ms / self.probe_min_ms

    @property
    def missed(self) -> bool:
        """Whether the ratio exceeds its limit, and that to the probe its own where it has one."""
        if self.ratio is None or self.limit is None or self.ratio <= self.limit:
            return False
        most = PROBE_LIMITS[self.mesh.removeprefix("reference_")] if self.against == "splu" else 0.0
        return self.probe_ratio is None or not self.probe_ratio <= most

    def as_json(self) -> dict[str, object]:
        """Return the record as a JSON object: the eight fixed keys, then others that are known."""
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
        comparison = {} if self.ratio is None else {"ratio": self.ratio, "limit": self.limit}
        compared = {} if self.scipy_ratio is None else {"scipy_ratio": self.scipy_ratio}
        probed = {} if self.probe_ratio is None else {"probe_ratio": self.probe_ratio}
        return fixed | comparison | compared | probed | self.extras


def set_ratios(records: Iterable[Record]) -> None:
    """Set the ratios that have a target, from the shortest times of one run."""
    records = list(records)
    tripod = {each.mesh: each for each in records if each.scene == "tripod" and each.path == "numba"}
    clamped = {each.mesh: each for each in records if each.scene == "held_centre" and each.path == "numba"}
    slow = {(each.scene, each.mesh): each for each in records if each.path == "scipy"}
    for record in records:
        if record.path != "numba":
            continue
        if (record.scene, record.mesh) in slow:
            record.scipy_ratio = record.min_ms / slow[record.scene, record.mesh].min_ms
        if record.scene == "held_centre" and record.splu_min_ms is not None:
            record.ratio, record.limit = record.min_ms / record.splu_min_ms, CLAMPED_LIMIT
            record.against = "splu"
        elif record.scene == "tripod" and record.mesh in clamped:
            body = clamped[record.mesh]
            record.ratio, record.limit = record.min_ms / body.min_ms, TRIPOD_LIMIT
            record.extras["median_ratio"] = record.median_ms / body.median_ms
            record.against = "held"
        elif record.scene == "inverse" and record.mesh in tripod:
            step = tripod[record.mesh]
            record.ratio, record.limit = record.min_ms / step.min_ms, TICK_LIMIT
            record.extras["median_ratio"] = record.median_ms / step.median_ms
            record.against = "tripod"
        elif record.scene in LIMITS and record.mesh in clamped:
            record.ratio = record.min_ms / clamped[record.mesh].min_ms
            record.limit, record.against = LIMITS[record.scene] / CLAMPED_MS, "held"


class JsonRecord(Protocol):
    """A measurement with a JSON form."""

    def as_json(self) -> dict[str, object]:
        """Return the measurement as a JSON object."""
        ...


def write_json(records: Iterable[JsonRecord], file: Path) -> None:
    """Write the records as a list of objects.

    Raises:
        OSError: the file cannot be written.
    """
    write_file(file, json.dumps([record.as_json() for record in records], indent=1) + "\n")


HEAD = (
    "scene",
    "mesh",
    "path",
    "nodes",
    "tets",
    "reference",
    "min ms",
    "median ms",
    "splu min",
    "of scipy",
    "in probes",
    "ratio",
    "target",
    "verdict",
)

PEER_HEAD = (
    "mesh",
    "engine",
    "min ms",
    "median ms",
    "ours min",
    "ours/its",
    "sag mm",
    "ours mm",
    "version",
    "method",
)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}" if value < 10.0 else f"{value:.1f}"


def _share(value: float) -> str:
    """Return a ratio in a readable form: 1/7.2 below one, 1.35 above."""
    return f"1/{1.0 / value:.1f}" if 0.0 < value < 0.9 else f"{value:.2f}"


def row(record: Record) -> tuple[str, ...]:
    """Return one record as text, a cell for each column of HEAD."""
    nodes, tets = reference_size(record.scene, record.mesh)
    cells = (
        record.scene,
        record.mesh,
        record.path,
        str(record.nodes),
        str(record.elements),
        f"{nodes}, {tets}",
        _number(record.min_ms),
        _number(record.median_ms),
        _number(record.splu_min_ms),
        "" if record.scipy_ratio is None else _share(record.scipy_ratio),
        _number(record.probe_ratio),
    )
    if record.ratio is None or record.limit is None:
        return (*cells, "", "", "")
    ratio, target = f"{_share(record.ratio)} {record.against}", f"<= {_share(record.limit)}"
    if record.against == "splu":
        target += f" or {PROBE_LIMITS[record.mesh.removeprefix('reference_')]:g} probes"
    return (*cells, ratio, target, "MISSED" if record.missed else "ok")


def peer_row(record: Record) -> tuple[str, ...]:
    """Return one record of another engine as text, a cell for each column of PEER_HEAD."""
    extras: dict[str, Any] = record.extras
    ours = float(extras["ours_min_ms"])
    return (
        record.mesh,
        record.path,
        _number(record.min_ms),
        _number(record.median_ms),
        _number(ours),
        _share(ours / record.min_ms),
        _number(extras["sag_mm"]),
        _number(extras["ours_sag_mm"]),
        str(extras["version"]),
        str(extras["method"]),
    )


def table(records: Iterable[Record]) -> list[str]:
    """Return the records as lines of aligned columns, head first."""
    return align_columns([HEAD, *(row(record) for record in records)])


def peer_table(records: Iterable[Record]) -> list[str]:
    """Return records of other engines as lines of aligned columns, head first."""
    return align_columns([PEER_HEAD, *(peer_row(record) for record in records)])


def align_columns(rows: list[tuple[str, ...]]) -> list[str]:
    """Return rows as lines with columns of equal width."""
    widths = [max(len(cells[column]) for cells in rows) for column in range(len(rows[0]))]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(cells, widths, strict=True)).rstrip()
        for cells in rows
    ]
