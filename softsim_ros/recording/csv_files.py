"""Bags as CSV files: one a topic, one a component of the diagnostics."""

from __future__ import annotations

import csv
import dataclasses
import io
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from softsim_core.file_writing import write_file
from softsim_ros.recording.bag import Bag

LONGEST = 64
"""Topics with longer arrays (meshes, images) are no tables and are left out."""

Row = dict[str, Any]


class TooLongError(ValueError):
    """A message holds an array that is too long for columns."""


def write_csv(bag: Bag, folder: Path) -> tuple[list[Path], list[str]]:
    """Write every topic that fits into a table.

    The first column is `recorded_s`, the time since the bag's first message; floats keep every digit.

    Args:
        bag: Open bag.
        folder: Existing folder.

    Returns:
        The files, and the topics that were left out.
    """
    files, left_out = [], []
    for topic in sorted(bag.topics):
        try:
            tables = _tables(bag, topic)
        except TooLongError:
            left_out.append(topic)
            continue
        for name, rows in tables.items():
            files.append(folder / f"{name}.csv")
            _write(files[-1], rows)
    return files, left_out


def _tables(bag: Bag, topic: str) -> dict[str, list[Row]]:
    name = file_name(bag, topic)
    tables: dict[str, list[Row]] = {}
    kind = bag.topics[topic]
    for stamp, message in bag.messages(topic):
        time = {"recorded_s": 1e-9 * (stamp - bag.begin_ns)}
        if kind == "diagnostic_msgs/msg/DiagnosticArray":
            for status in message.status:
                key = f"{name}_{_safe(status.name)}"
                tables.setdefault(key, []).append({**time, **diagnostic_row(status)})
        else:
            row = joint_row(message) if kind == "sensor_msgs/msg/JointState" else dict(flat(message))
            tables.setdefault(name, []).append({**time, **row})
    return tables


def file_name(bag: Bag, topic: str) -> str:
    """Name of a topic's file: without the robot's namespace, underscores for slashes."""
    return _safe(topic.removeprefix(bag.namespace.rstrip("/") + "/"))


def flat(message: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """The values of a message by dotted names: "pose.position.x", "data.0"; the stamp as seconds.

    Raises:
        TooLongError: an array with more than LONGEST entries.
    """
    for field in dataclasses.fields(message):
        if field.name == "__msgtype__":
            continue
        yield from _flat_value(getattr(message, field.name), f"{prefix}{field.name}")


def _flat_value(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    if dataclasses.is_dataclass(value):
        if {"sec", "nanosec"} == {each.name for each in dataclasses.fields(value)} - {"__msgtype__"}:
            yield name, getattr(value, "sec") + 1e-9 * getattr(value, "nanosec")  # noqa: B009
        else:
            yield from flat(value, f"{name}.")
    elif isinstance(value, (str, int, float)):
        yield name, value
    else:
        if len(value) > LONGEST:
            raise TooLongError(name)
        for index, item in enumerate(value.tolist() if hasattr(value, "tolist") else value):
            yield from _flat_value(item, f"{name}.{index}")


def joint_row(message: Any) -> Row:
    """Position, velocity and effort of each joint by its name."""
    row: Row = dict(_flat_value(message.header, "header"))
    for quantity in ("position", "velocity", "effort"):
        values = getattr(message, quantity).tolist()
        row |= {f"{joint}.{quantity}": value for joint, value in zip(message.name, values, strict=False)}
    return row


def diagnostic_row(status: Any) -> Row:
    """Level, sentence and values of a component; numbers as numbers."""
    return {
        "level": int(status.level),
        "message": status.message,
        **{entry.key: _number(entry.value) for entry in status.values},
    }


def _number(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def _safe(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", name).strip("_")


def _write(file: Path, rows: Iterable[Row]) -> None:
    rows = list(rows)
    columns = list(dict.fromkeys(column for row in rows for column in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, restval="")
    writer.writeheader()
    writer.writerows(rows)
    write_file(file, text.getvalue())
