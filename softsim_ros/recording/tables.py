"""A recording as a table of measurements: a row for each message of a topic, and what others said before."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from softsim_core.arrays import Array
from softsim_core.errors import DataError
from softsim_core.identification.readers import READERS
from softsim_core.identification.table import Table
from softsim_core.wrong_names import known_names
from softsim_ros.recording.bag import Bag
from softsim_ros.recording.csv_files import TooLongError, flat, joint_row

RECORDED: Final = "recorded_s"
"""The column with the time of each row since the recording's first message, in [s]."""

ENDINGS: Final = (".mcap", ".db3", "")
"""Of what is read: files, and the folders that `softsim record` makes."""


def read_bag(path: Path, columns: Sequence[str]) -> Table:
    """The columns TOPIC:FIELD of a recording, such as `effector_pose:pose.position.x`.

    Rows are the messages of the first column's topic from which on all others have spoken. Of other topics,
    the newest message before the row counts. Fields are named as `softsim export` names them; of joint
    states, `joint_states:servo_0.position`.

    Args:
        path: Folder or file of a recording.
        columns: What is asked for; `recorded_s` is the time of the row.

    Raises:
        BagError: it cannot be read.
        DataError: no such topic or field, or no row.
    """
    asked = [column for column in columns if column != RECORDED]
    with Bag(path) as bag:
        fields: dict[str, list[str]] = {}
        for column in asked:
            topic, colon, field = column.rpartition(":")
            if not colon:
                raise DataError(path, f"column {column}", "must be TOPIC:FIELD, or recorded_s")
            fields.setdefault(bag.topic(topic), []).append(field)
        if not fields:
            raise DataError(path, "", "no column of a topic is asked for")
        series = {topic: _series(bag, topic, wanted) for topic, wanted in fields.items()}
        begin = bag.begin_ns
        names = {
            column: (bag.topic(column.rpartition(":")[0]), column.rpartition(":")[2]) for column in asked
        }
    first = next(iter(series))
    stamps = series[first][0]
    newest = {topic: np.searchsorted(own, stamps, side="right") - 1 for topic, (own, _) in series.items()}
    rows = np.all([index >= 0 for index in newest.values()], axis=0)
    if not rows.any():
        raise DataError(path, f"topic {first}", "no message of it comes after the first ones of the others")
    told: dict[str, Sequence[str] | Array] = {RECORDED: 1e-9 * (stamps[rows] - begin)}
    for column, (topic, field) in names.items():
        told[column] = series[topic][1][field][newest[topic][rows]]
    return Table(path, told, (np.flatnonzero(rows) + 1).tolist())


def _series(bag: Bag, topic: str, wanted: list[str]) -> tuple[Any, dict[str, Array]]:
    """Stamps in [ns] and values of the fields of a topic's messages; nan where a message has none."""
    if topic not in bag.topics:
        raise DataError(
            bag.path, f"topic {topic}", f"is not there; {known_names(topic, sorted(bag.topics), 'there are')}"
        )
    stamps, values = [], []
    known: dict[str, Any] = {}
    for stamp, row in _rows(bag, topic):
        known = row
        stamps.append(stamp)
        values.append([row.get(field, np.nan) for field in wanted])
    for field in wanted:
        if field not in known:
            raise DataError(
                bag.path, f"column {topic}:{field}", f"is not there; {known_names(field, known, 'there are')}"
            )
    try:
        numbers = np.array(values, dtype=float)
    except ValueError as error:
        raise DataError(bag.path, f"topic {topic}", f"a field is no number ({error})") from error
    return np.array(stamps, dtype=np.int64), {field: numbers[:, k] for k, field in enumerate(wanted)}


def _rows(bag: Bag, topic: str) -> Iterator[tuple[int, dict[str, Any]]]:
    of_joints = bag.topics[topic] == "sensor_msgs/msg/JointState"
    for stamp, message in bag.messages(topic):
        try:
            yield stamp, joint_row(message) if of_joints else dict(flat(message))
        except TooLongError as error:
            raise DataError(bag.path, f"topic {topic}", "holds long arrays, which are no columns") from error


def register() -> None:
    """Let data sets name recordings as their tables."""
    READERS.update(dict.fromkeys(ENDINGS, read_bag))
