"""Trained policies as ONNX files: declared contents, checks before loading, and match with task and robot.

A file of a few hundred bytes can name other files to read (external data), a constant of any size, and
functions that unfold to any number of nodes. Only the fields that declare these are read; onnx.proto numbers
them.
"""

from __future__ import annotations

import functools
import importlib
import json
import math
import threading
import warnings
from collections.abc import Iterator, Mapping
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Literal, TypeAlias

import numpy as np

from softsim_core.base import Array, PolicyError, install_command, listing
from softsim_core.lab.learning.tasks import TASKS, Numbers, Senses
from softsim_core.scene import RobotDescription

Kind: TypeAlias = Literal["model", "training", "graph", "node", "attribute", "tensor", "sparse tensor"]

_PARTS: Final = MappingProxyType[Kind, dict[int, Kind]](
    {
        "model": {7: "graph", 20: "training"},
        "training": {1: "graph", 2: "graph"},
        "graph": {1: "node", 5: "tensor", 15: "sparse tensor"},
        "node": {5: "attribute"},
        "attribute": {
            5: "tensor", 6: "graph", 10: "tensor", 11: "graph", 22: "sparse tensor", 23: "sparse tensor",
        },
        "sparse tensor": {1: "tensor", 2: "tensor"},
        "tensor": {},
    }
)  # fmt: skip
"""Nested messages by field."""

_ONCE: Final = frozenset({("model", 7), ("attribute", 5), ("attribute", 6), ("attribute", 22),
                          ("sparse tensor", 1), ("sparse tensor", 2)})  # fmt: skip
"""Fields that may occur once: from two, a reader would make one constant with the sizes of both."""

_DIMENSIONS: Final = MappingProxyType({"tensor": 1, "sparse tensor": 3})
_DATA_TYPE, _EXTERNAL_DATA, _DATA_LOCATION, _FUNCTIONS = 2, 13, 14, 25
_BYTES: Final = MappingProxyType({1: 4, 2: 1, 3: 1, 4: 2, 5: 2, 6: 4, 9: 1, 10: 2, 12: 4, 8: 32, 15: 16})
"""Bytes of a number by data type, if it is not 8; for a text the least number."""


def objection(data: bytes, most_bytes: int) -> str:
    """Return why a model's file must not be loaded, as "it reads other files ..."; empty: it may be loaded.

    All its constants together may take `most_bytes`.
    """
    total = 0
    waiting: list[tuple[Kind, memoryview]] = [("model", memoryview(data))]
    try:
        while waiting:
            kind, message = waiting.pop()
            dimensions, width, found = [], 8, set()
            for field, value in _fields(message):
                part = _PARTS[kind].get(field)
                if part is not None and isinstance(value, memoryview):
                    if field in found and (kind, field) in _ONCE:
                        return f"a field of its {kind} stands there twice"
                    found.add(field)
                    waiting.append((part, value))
                elif kind == "model" and field == _FUNCTIONS:
                    return (
                        "it defines functions of its own; inline them (onnx.inliner.inline_local_functions)"
                    )
                elif kind == "tensor" and (
                    field == _EXTERNAL_DATA or (field == _DATA_LOCATION and value != 0)
                ):
                    return "it keeps constants in other files (external data); save it as one file"
                elif field == _DIMENSIONS.get(kind):
                    dimensions += _integers(value)
                elif kind == "tensor" and field == _DATA_TYPE and isinstance(value, int):
                    width = _BYTES.get(value, 8)
            if kind in _DIMENSIONS:
                total += width * math.prod(dimensions)
                if total > most_bytes:
                    return f"its constants take {total} bytes or more; at most {most_bytes} are allowed"
    except (IndexError, ValueError):
        return "it is no ONNX file that ONNX Runtime can run (damaged)"
    return ""


def _fields(message: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """Yield number and value of each field, an integer or bytes; ValueError, IndexError: no such message."""
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        wire = key & 7
        if wire == 0:
            value, at = _varint(message, at)
            yield key >> 3, value
            continue
        if wire == 2:
            size, at = _varint(message, at)
        else:
            size = {1: 8, 5: 4}.get(wire, len(message) + 1)
        if at + size > len(message):
            raise ValueError(wire)
        yield key >> 3, message[at : at + size]
        at += size


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for place in range(10):
        byte = message[at + place]
        value |= (byte & 0x7F) << 7 * place
        if byte < 0x80:
            return value, at + place + 1
    raise ValueError(value)


def _integers(value: int | memoryview) -> list[int]:
    """Return one integer, or the integers packed into bytes."""
    if isinstance(value, int):
        return [value]
    found, at = [], 0
    while at < len(value):
        number, at = _varint(value, at)
        found.append(number)
    return found


_ABOUT: Final = "softsim_"
_LARGEST_BYTES: Final = 100_000_000
LONGEST_ACTION_S: Final = 1.0
"""A policy that has not answered within this time in [s] is stopped."""

MOST_MEMORY: Final = 256 << 20
"""Memory limit in bytes of constants, and of all computations of a process's policies."""

_ROUNDED: Final = 1e-9  # limits of a joint may be narrower than commands of the task by this, in [rad] or [m]


def policy_metadata(name: str) -> dict[str, str]:
    """Return the metadata of the file of a task's policy, in the form of ONNX (`metadata_props`).

    Returns:
        Task, robot and rate in [Hz]; observation and action in JSON: name, unit and count of numbers of each
        part, and for each joint its name, unit and the commands that -1 and 1 stand for.

    Raises:
        PolicyError: no such task.
    """
    if name not in TASKS:
        raise PolicyError(name, f"no such task; known: {listing(TASKS)}")
    task = TASKS[name]
    robot = task.description()
    observation = [{"name": each.name, "unit": each.unit, "size": each.size} for each in task.groups]
    action = [
        {"joint": joint.name, "unit": joint.units.command.si, "low": low, "high": high}
        for joint, low, high in zip(robot.joints, task.low, task.high, strict=True)
    ]
    return {
        f"{_ABOUT}task": name,
        f"{_ABOUT}robot": robot.name,
        f"{_ABOUT}rate_hz": f"{1.0 / (task.steps * robot.scene.dt):g}",
        f"{_ABOUT}observation": json.dumps(observation),
        f"{_ABOUT}action": json.dumps(action),
    }


class Policy:
    """A loaded policy; `load_policy` creates it.

    Attributes:
        name: Its task's name.
        task: Its task.
        rate: Actions per second.
    """

    def __init__(self, file: Path, name: str, rate: float, session: Any) -> None:
        self.name, self.task, self.rate = name, TASKS[name], rate
        self._file, self._session = file, session
        self._input, self._output = session.get_inputs()[0].name, session.get_outputs()[0].name

    def actions(self, observations: Numbers) -> Numbers:
        """Return actions, shape (k, j) float32, for observations (k, m) float32.

        Raises:
            PolicyError: no answer within a second or `MOST_MEMORY`, one that is not finite, or of another
                shape.
        """
        found = np.asarray(self._run(observations))
        expected = (len(observations), len(self.task.low))
        if found.shape != expected:
            raise PolicyError(self._file, f"it answered with the shape {found.shape}, not {expected}")
        if not np.isfinite(found).all():
            raise PolicyError(self._file, "it answered with a number that is not finite; nothing was moved")
        return found

    def _run(self, observations: Numbers) -> Any:
        """Compute the answer, or raise PolicyError if there is none within the time limit."""
        options = _runtime(self._file).RunOptions()
        options.log_severity_level = 4
        late = threading.Event()

        def stop() -> None:
            late.set()
            options.terminate = True

        timer = threading.Timer(LONGEST_ACTION_S, stop)
        timer.daemon = True
        timer.start()
        try:
            return self._session.run([self._output], {self._input: observations}, options)[0]
        except Exception as error:  # the runtime's own errors have no common base class
            if late.is_set():
                what = f"it has not answered within {LONGEST_ACTION_S:g} s"
            else:
                what = f"it cannot answer ({_reason(error)})"
            raise PolicyError(self._file, f"{what}; nothing was moved") from error
        finally:
            timer.cancel()

    def command(self, senses: Senses) -> Array:
        """Return the next commands for the servos of k robots in [rad] or [m], shape (k, j).

        The observation is the environment's, without the simulated noise of sensors.

        Raises:
            PolicyError: see `actions`.
        """
        observations = self.task.observation(self.task.sense(senses))
        return self.task.command(self.actions(observations), self.task.devices.command_step)

    def check_robot(self, robot: RobotDescription) -> int:
        """Reject a robot that the policy cannot drive.

        Returns:
            Index of the task's rigid body among all of the scene; -1: the task has none.

        Raises:
            PolicyError: other joints, commands beyond their limits, no effector, or no such rigid body.
        """
        trained_robot = self.task.description()
        trained_joints, joints = _joints(trained_robot), _joints(robot)
        if joints != trained_joints:
            raise PolicyError(
                self._file,
                f"it drives {trained_robot.name} with the joints {listing(trained_joints)}; "
                f"{robot.name} has {listing(joints)}",
            )
        for joint, low, high in zip(robot.joints, self.task.low, self.task.high, strict=True):
            limits = joint.limits
            if not (limits.lower - _ROUNDED <= low and high <= limits.upper + _ROUNDED):
                raise PolicyError(
                    self._file,
                    f"it commands {joint.name} from {low:g} to {high:g}; {robot.name} allows "
                    f"{limits.lower:g} to {limits.upper:g}",
                )
        if "effector_position" in self.task.asks and robot.scene.effector is None:
            raise PolicyError(self._file, f"it looks at the effector, and {robot.name} has none")
        names = [body.name for body in robot.scene.rigid_bodies]
        if not self.task.thing:
            return -1
        if self.task.thing not in names:
            raise PolicyError(
                self._file,
                f"it looks at the rigid body {self.task.thing}; {robot.name} has {listing(names)}",
            )
        return names.index(self.task.thing)


def load_policy(file: str | PathLike[str]) -> Policy:
    """Load a policy from its ONNX file, checked against the task that it names.

    Raises:
        PolicyError: ONNX Runtime is not installed, or the file cannot be read or does not fit.
    """
    path = Path(file).expanduser()
    session = _session(path)
    metadata: Mapping[str, str] = session.get_modelmeta().custom_metadata_map
    name = metadata.get(f"{_ABOUT}task", "")
    if name not in TASKS:
        tasks = listing(TASKS)
        what = f"its task is {name[:80]!r}" if name else f"it does not name its task ({_ABOUT}task)"
        raise PolicyError(path, f"{what}; known: {tasks}; see policy_metadata in docs/learning.md")
    expected = policy_metadata(name)
    for key, value in expected.items():
        if metadata.get(key) != value:
            raise PolicyError(
                path,
                f"{key} is {metadata.get(key, 'missing')[:200]}, and {name} of this version wants {value}",
            )
    task = TASKS[name]
    for kind, found, size in (
        ("input", session.get_inputs(), sum(each.size for each in task.groups)),
        ("output", session.get_outputs(), len(task.low)),
    ):
        shapes = [(each.type, each.shape) for each in found]
        fits = len(found) == 1 and shapes[0][0] == "tensor(float)" and len(shapes[0][1]) == 2
        if not fits or isinstance(shapes[0][1][0], int) or shapes[0][1][1] != size:
            raise PolicyError(
                path, f"its {kind} is {shapes}; {name} wants one, tensor(float) of any number by {size}"
            )
    return Policy(path, name, float(expected[f"{_ABOUT}rate_hz"]), session)


def _joints(robot: RobotDescription) -> list[str]:
    return [f"{joint.name} [{joint.units.command.si}]" for joint in robot.joints]


def _runtime(path: Path) -> Any:
    """Return ONNX Runtime, or raise PolicyError if it is not installed."""
    try:
        return importlib.import_module("onnxruntime")
    except ImportError as error:
        raise PolicyError(path, f"{error}; {install_command('policy')}") from error


@functools.cache
def _limit_memory(runtime: Any) -> None:
    """Give all sessions of this process one allocator, limited to `MOST_MEMORY`."""
    memory = runtime.OrtMemoryInfo(
        "Cpu", runtime.OrtAllocatorType.ORT_ARENA_ALLOCATOR, 0, runtime.OrtMemType.DEFAULT
    )
    # 1: allocate the requested size, not twice as much
    limits = {"max_mem": MOST_MEMORY, "arena_extend_strategy": 1}
    runtime.create_and_register_allocator(memory, runtime.OrtArenaCfg(limits))


def _reason(error: Exception) -> str:
    return " ".join(str(error).split())[:120]


def _session(path: Path) -> Any:
    runtime = _runtime(path)
    try:
        if (size := path.stat().st_size) > _LARGEST_BYTES:
            raise PolicyError(path, f"{size} bytes are more than the {_LARGEST_BYTES} allowed")
        data = path.read_bytes()
    except OSError as error:
        raise PolicyError(path, f"it cannot be read: {error.strerror}") from error
    if problem := objection(data, MOST_MEMORY):
        raise PolicyError(path, problem)
    _limit_memory(runtime)
    options = runtime.SessionOptions()
    options.add_session_config_entry("session.use_env_allocators", "1")
    # constant folding would run here, without a time limit
    options.graph_optimization_level = runtime.GraphOptimizationLevel.ORT_DISABLE_ALL
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return runtime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # the runtime's own errors have no common base class
            what = f"it is no ONNX file that ONNX Runtime can run ({_reason(error)})"
            raise PolicyError(path, what) from error
