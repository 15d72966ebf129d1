"""Bags of random commands for the tests."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rosbags.typesys import Stores, get_typestore

from softsim_ros.recording import BagWriter

TYPES = get_typestore(Stores.ROS2_JAZZY)
COMMANDS = "/tripod/position_controller/commands"
NOTES = {"robot": "tripod", "namespace": "/tripod"}
Row = tuple[str, int, bytes]


def command(values: list[float]) -> bytes:
    layout = TYPES.types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    message = TYPES.types["std_msgs/msg/Float64MultiArray"](layout=layout, data=np.array(values))
    return bytes(TYPES.serialize_cdr(message, "std_msgs/msg/Float64MultiArray"))


def rows(count: int, size: int = 3) -> list[Row]:
    numbers = np.random.default_rng(7).normal(size=(count, size))
    return [(COMMANDS, 1_000_000_000 + 10_000_000 * k, command(list(row))) for k, row in enumerate(numbers)]


def write(folder: Path, messages: list[Row], **notes: str) -> BagWriter:
    writer = BagWriter(folder, {**NOTES, **notes})
    for topic, stamp, data in messages:
        writer.add_topic(topic, "std_msgs/msg/Float64MultiArray")
        writer.write(topic, stamp, data)
    return writer
