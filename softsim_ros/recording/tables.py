"""Bags as tables: CSV files per topic, and rows of measurements."""

from __future__ import annotations

import csv
import dataclasses
import io
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from softsim_core.base import Array, DataError, known_names, write_file
from softsim_core.lab.identification import READERS, Table
from softsim_ros.recording.bag import Bag

LONGEST = 64
"""Longest array in a table; topics with longer ones (meshes, images) are left out."""

Row = dict[str, Any]


class TooLongError(ValueError):
    """A message contains an array that is too long for columns."""


def write_csv(bag: Bag, folder: Path) -> tuple[list[Path], list[str]]:
    """Write every topic that fits into a table; return the files, and the topics that were left out.

    The first column is `recorded_s`, the time since the bag's first message; floats are written with all
    digits. The folder must exist.
    """
    files, left_out = [], []
    for topic in sorted(bag.topics):
        try:
            tables = _tables(bag, topic)
        except TooLongError:
            left_out.append(topic)
            continue
        for name, rows in tables.items():
            text = io.StringIO()
            writer = csv.DictWriter(text, dict.fromkeys(column for row in rows for column in row), restval="")
            writer.writeheader()
            writer.writerows(rows)
            files.append(write_file(folder / f"{name}.csv", text.getvalue()))
    return files, left_out


def _tables(bag: Bag, topic: str) -> dict[str, list[Row]]:
    """Return the rows of a topic by the name of their file, which begins without the robot's namespace."""
    name = _safe(topic.removeprefix(bag.namespace.rstrip("/") + "/"))
    tables: dict[str, list[Row]] = {}
    for stamp, message in bag.messages(topic):
        time = {"recorded_s": 1e-9 * (stamp - bag.begin_ns)}
        if bag.topics[topic] == "diagnostic_msgs/msg/DiagnosticArray":
            for status in message.status:
                key = f"{name}_{_safe(status.name)}"
                tables.setdefault(key, []).append({**time, **diagnostic_row(status)})
        else:
            tables.setdefault(name, []).append({**time, **_message_row(message)})
    return tables


def _message_row(message: Any) -> Row:
    """Return the values of a message by name; those of joint states by the names of the joints."""
    if message.__msgtype__ != "sensor_msgs/msg/JointState":
        return dict(flat(message))
    row: Row = dict(_flat_value(message.header, "header"))
    for quantity in ("position", "velocity", "effort"):
        values = getattr(message, quantity).tolist()
        row |= {f"{joint}.{quantity}": value for joint, value in zip(message.name, values, strict=False)}
    return row


def flat(message: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values of a message by dotted names: "pose.position.x", "data.0"; the stamp in seconds.

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


def diagnostic_row(status: Any) -> Row:
    """Return level, message and values of a component; numbers as numbers."""
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


RECORDED: Final = "recorded_s"
"""Column with the time of each row since the recording's first message, in [s]."""

ENDINGS: Final = (".mcap", ".db3", "")
"""Suffixes of readable paths: files, and the folders that `softsim record` creates."""


def read_bag(path: Path, columns: Sequence[str]) -> Table:
    """Return the columns TOPIC:FIELD of a recording, such as `effector_pose:pose.position.x`.

    Rows are the messages of the first column's topic, from the time on at which all other topics have a
    message. For other topics the newest message before the row is used. Fields are named as `softsim export`
    names them; for joint states, `joint_states:servo_0.position`.

    Args:
        path: Folder or file of a recording.
        columns: Requested columns; `recorded_s` is the time of the row.

    Raises:
        BagError: it cannot be read.
        DataError: no such topic or field, or no row.
    """
    places: dict[str, tuple[str, str]] = {}
    with Bag(path) as bag:
        for column in columns:
            topic, colon, field = column.rpartition(":")
            if colon:
                places[column] = (bag.topic(topic), field)
            elif column != RECORDED:
                raise DataError(path, f"column {column}", "must be TOPIC:FIELD, or recorded_s")
        if not places:
            raise DataError(path, "", "no column of a topic is asked for")
        fields: dict[str, list[str]] = {}
        for topic, field in places.values():
            fields.setdefault(topic, []).append(field)
        series = {topic: _series(bag, topic, names) for topic, names in fields.items()}
        begin = bag.begin_ns
    first = next(iter(series))
    stamps = series[first][0]
    newest = {topic: np.searchsorted(own, stamps, side="right") - 1 for topic, (own, _) in series.items()}
    rows = np.all([index >= 0 for index in newest.values()], axis=0)
    if not rows.any():
        raise DataError(path, f"topic {first}", "no message of it comes after the first ones of the others")
    table: dict[str, Sequence[str] | Array] = {RECORDED: 1e-9 * (stamps[rows] - begin)}
    for column, (topic, field) in places.items():
        table[column] = series[topic][1][field][newest[topic][rows]]
    return Table(path, table, (np.flatnonzero(rows) + 1).tolist())


def _series(bag: Bag, topic: str, field_names: list[str]) -> tuple[Any, dict[str, Array]]:
    """Return stamps in [ns] and values of the fields of a topic's messages; nan where a message has none."""
    if topic not in bag.topics:
        raise DataError(
            bag.path, f"topic {topic}", f"is not there; {known_names(topic, sorted(bag.topics), 'there are')}"
        )
    stamps, values = [], []
    row: Row = {}
    for stamp, message in bag.messages(topic):
        try:
            row = _message_row(message)
        except TooLongError as error:
            raise DataError(bag.path, f"topic {topic}", "holds long arrays, which are no columns") from error
        stamps.append(stamp)
        values.append([row.get(field, np.nan) for field in field_names])
    for field in field_names:
        if field not in row:
            hint = known_names(field, row, "there are")
            raise DataError(bag.path, f"column {topic}:{field}", f"is not there; {hint}")
    try:
        numbers = np.array(values, dtype=float)
    except ValueError as error:
        raise DataError(bag.path, f"topic {topic}", f"a field is no number ({error})") from error
    return np.array(stamps, dtype=np.int64), {field: numbers[:, k] for k, field in enumerate(field_names)}


def register() -> None:
    """Allow data sets to use recordings as their tables."""
    READERS.update(dict.fromkeys(ENDINGS, read_bag))
