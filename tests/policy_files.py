"""Policies that were not trained, for tests: a linear map with random weights, as an ONNX file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np


def write_policy(file: Path, task: str, weight: float | None = None, **changes: Any) -> Path:
    """Write one for a task.

    Args:
        file: Where to.
        task: Name of the task.
        weight: Of every weight; None: random, of a fixed seed.
        changes: Metadata that differ ("" leaves them out), or another number of `inputs` or `outputs`.

    Returns:
        `file`.
    """
    import onnx
    from onnx import helper, numpy_helper

    from softsim_core.learning.policy import policy_metadata
    from softsim_core.learning.tasks import TASKS

    width = changes.pop("inputs", sum(each.size for each in TASKS[task].sensed))
    height = changes.pop("outputs", len(TASKS[task].low))
    weights = np.random.default_rng(4).uniform(-0.5, 0.5, (width, height)).astype(np.float32)
    if weight is not None:
        weights[:] = weight
    number = onnx.TensorProto.FLOAT
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["observation", "weights"], ["action"])],
        "linear",
        [helper.make_tensor_value_info("observation", number, ["n", width])],
        [helper.make_tensor_value_info("action", number, ["n", height])],
        [numpy_helper.from_array(weights, "weights")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    told = {**policy_metadata(task), **changes}
    helper.set_model_props(model, {name: value for name, value in told.items() if value})
    onnx.save(model, file)
    return file
