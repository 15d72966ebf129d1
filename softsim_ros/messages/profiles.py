"""The stages of the last steps as one message: a table whose columns are named in its layout."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout

from softsim_core.arrays import Array
from softsim_ros.messages.buffers import message_array


def step_profile(stages: Sequence[str], rows: Array) -> Float64MultiArray:
    """Steps with the times of their stages.

    Args:
        stages: Names of the stages, length s; the label of the second dimension joins them by commas.
        rows: Number, simulated time in [s], time of each stage in [ms], oldest step first, shape (k, 2 + s).
    """
    count, width = rows.shape
    dimensions = [
        MultiArrayDimension(label="steps", size=count, stride=count * width),
        MultiArrayDimension(label=",".join(("step", "time_s", *stages)), size=width, stride=width),
    ]
    return Float64MultiArray(layout=MultiArrayLayout(dim=dimensions), data=message_array(rows, "d"))


def read_step_profile(message: Float64MultiArray) -> tuple[tuple[str, ...], Array]:
    """Stages and rows of a message made by `step_profile`."""
    steps, columns = message.layout.dim
    rows = np.frombuffer(message.data, dtype=float).reshape(steps.size, columns.size)
    return tuple(columns.label.split(",")[2:]), rows
