"""Policies that were not trained, for tests: a linear map with random weights, as an ONNX file."""

from __future__ import annotations

from collections.abc import Sequence
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

    from softsim_core.lab.learning import TASKS, policy_metadata

    width = changes.pop("inputs", sum(each.size for each in TASKS[task].groups))
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


def constant(name: str, value: Any) -> Any:
    """A constant of a graph."""
    from onnx import numpy_helper

    return numpy_helper.from_array(np.asarray(value), name)


def write_graph(file: Path, task: str, nodes: Sequence[Any], constants: Sequence[Any], **more: Any) -> Path:
    """Write a policy of other nodes, "observation" to "action"; `more` is added to lists of the model."""
    import onnx

    model = onnx.load(write_policy(file, task))
    del model.graph.node[:], model.graph.initializer[:]
    model.graph.node.extend(nodes)
    model.graph.initializer.extend(constants)
    for name, value in more.items():
        getattr(model, name).extend(value)
    file.write_bytes(model.SerializeToString())
    return file


def write_endless_policy(file: Path, task: str) -> Path:
    """Write a policy whose loop makes 2^62 turns."""
    from onnx import TensorProto, helper

    from softsim_core.lab.learning import TASKS

    body = helper.make_graph(
        [
            helper.make_node("Identity", ["on"], ["still_on"]),
            helper.make_node("Add", ["value", "value"], ["next"]),
        ],
        "body",
        [
            helper.make_tensor_value_info("turn", TensorProto.INT64, []),
            helper.make_tensor_value_info("on", TensorProto.BOOL, []),
            helper.make_tensor_value_info("value", TensorProto.FLOAT, None),
        ],
        [
            helper.make_tensor_value_info("still_on", TensorProto.BOOL, []),
            helper.make_tensor_value_info("next", TensorProto.FLOAT, None),
        ],
    )
    nodes = [
        helper.make_node("Loop", ["turns", "yes", "observation"], ["looped"], body=body),
        helper.make_node("MatMul", ["looped", "weights"], ["action"]),
    ]
    weights = np.zeros((sum(each.size for each in TASKS[task].groups), len(TASKS[task].low)), np.float32)
    constants = [constant("turns", 2**62), constant("yes", True), constant("weights", weights)]
    return write_graph(file, task, nodes, constants)
