"""Records as a table for people."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from softsim_ros.benchmark.records import Record
from softsim_ros.benchmark.reference_sizes import reference_size

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
    """A ratio as people say it: 1/7.2 below one, 1.35 above."""
    return f"1/{1.0 / value:.1f}" if 0.0 < value < 0.9 else f"{value:.2f}"


def row(record: Record) -> tuple[str, ...]:
    """One record as text, a cell for each column of HEAD."""
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
    )
    if record.ratio is None or record.limit is None:
        return (*cells, "", "", "")
    ratio, target = f"{_share(record.ratio)} {record.against}", f"<= {_share(record.limit)}"
    return (*cells, ratio, target, "MISSED" if record.missed else "ok")


def peer_row(record: Record) -> tuple[str, ...]:
    """One record of another engine as text, a cell for each column of PEER_HEAD."""
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
    """The records as lines of aligned columns, head first."""
    return aligned([HEAD, *(row(record) for record in records)])


def peer_table(records: Iterable[Record]) -> list[str]:
    """Records of other engines as lines of aligned columns, head first."""
    return aligned([PEER_HEAD, *(peer_row(record) for record in records)])


def aligned(rows: list[tuple[str, ...]]) -> list[str]:
    """Rows as lines with columns of equal width."""
    widths = [max(len(cells[column]) for cells in rows) for column in range(len(rows[0]))]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(cells, widths, strict=True)).rstrip()
        for cells in rows
    ]
