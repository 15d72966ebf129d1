"""A MuJoCo model, read and compiled by MuJoCo's own library, with everything at its initial position."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from softsim_core.base import Array, IndexArray, MjcfError
from softsim_core.mjcf.engine import library, look_at
from softsim_core.mjcf.source import MOST_VERTICES, Source, read_source

_AXES = 3
_CHECKED = (
    *("body_pos", "body_mass", "body_inertia", "geom_pos", "geom_size"),
    *("flex_vert", "qpos0", "mesh_vert"),
)


@dataclass(slots=True)
class ConversionNotes:
    """Messages on parts that a conversion leaves out or changes, without duplicates."""

    lines: list[str] = field(default_factory=list)

    def say(self, what: str, note: str) -> None:
        """Add a message about a named part."""
        line = f"{what}: {note}"
        if line not in self.lines:
            self.lines.append(line)


class Names:
    """Allocator of names for scenes: letters, digits and underscores, without duplicates."""

    def __init__(self) -> None:
        self._used: set[str] = set()

    def new(self, proposed: str, otherwise: str) -> str:
        """Return a new name similar to the requested one, or to the other if that is empty."""
        clean = re.sub(r"\W+", "_", proposed, flags=re.ASCII).strip("_") or otherwise
        clean = clean if clean[0].isalpha() else f"{otherwise}_{clean}"
        name, number = clean, 2
        while name in self._used:
            name, number = f"{clean}_{number}", number + 1
        self._used.add(name)
        return name


@dataclass(frozen=True, slots=True, eq=False)
class CompiledModel:
    """A compiled model.

    Attributes:
        source: Its text.
        mujoco: The library.
        spec: The library's specification of the model.
        model: The compiled model.
        data: The initial state (qpos0), with all positions.
        notes: Messages so far.
        vertices: Whether each body is only a point of a flex, shape (b,).
        names: Allocator of names for bodies and other parts of a scene.
    """

    source: Source
    mujoco: Any
    spec: Any
    model: Any
    data: Any
    vertices: Array
    notes: ConversionNotes
    names: Names

    @property
    def file(self) -> Path:
        """The model's file."""
        return self.source.file

    def flex_name(self, f: int) -> str:
        """Return the name of a flex in messages."""
        return f"flex {self.spec.flexes[f].name or f}"

    def refusal(self, f: int) -> str:
        """Return why a flex is not converted to a soft body; empty: it is converted."""
        m = self.model
        if m.flex_dim[f] != _AXES:
            what = "a rope" if m.flex_dim[f] == 1 else "a sheet"
            return f"dim {m.flex_dim[f]} ({what}) is not taken over; soft bodies here are solid"
        if m.flex_rigid[f]:
            return "all its vertices are on one body, so it is rigid: it is not taken over"
        if not self.spec.flexes[f].young > 0.0:
            return "has no elasticity (young = 0): it is not taken over"
        return ""

    def flex_bodies(self, f: int) -> IndexArray:
        """Return the body of each vertex of a flex, or of each node of an interpolated one, shape (n,)."""
        m = self.model
        if m.flex_interp[f]:
            start = m.flex_nodeadr[f]
            return np.array(m.flex_nodebodyid[start : start + m.flex_nodenum[f]], dtype=np.int64)
        start = m.flex_vertadr[f]
        return np.array(m.flex_vertbodyid[start : start + m.flex_vertnum[f]], dtype=np.int64)

    def flex_points(self, f: int) -> Array:
        """Return the initial vertices of a flex in [m], shape (n, 3)."""
        start = self.model.flex_vertadr[f]
        return np.array(self.data.flexvert_xpos[start : start + self.model.flex_vertnum[f]])

    def is_vertex(self, body: int) -> bool:
        """Return whether a body is only a point of a flex, which moves along three axes."""
        return bool(self.vertices[body])


def _vertices(mujoco: Any, model: Any) -> Array:
    """Return whether each body is only a point of a flex, shape (b,)."""
    carries = np.zeros(model.nbody, dtype=bool)
    for numbers in (np.array(model.flex_vertbodyid), np.array(model.flex_nodebodyid)):
        carries[numbers[numbers >= 0]] = True
    is_slide = np.array(model.jnt_type) == mujoco.mjtJoint.mjJNT_SLIDE
    slides = np.bincount(np.array(model.jnt_bodyid)[is_slide], minlength=model.nbody)
    three = (slides == _AXES) & (np.array(model.body_jntnum) == _AXES)
    return np.asarray(carries & three & (np.array(model.body_geomnum) == 0))


def load_model(path: str | Path) -> CompiledModel:
    """Read and compile the model of an MJCF file.

    Raises:
        MjcfError: MuJoCo is missing, the file is rejected by this module or by MuJoCo, or is too large.
    """
    source = read_source(path)
    mujoco = library(source.file)
    look_at(source.file)
    try:
        with warnings.catch_warnings():  # warns for every soft flex that it has no passive forces
            warnings.simplefilter("ignore")
            spec = mujoco.MjSpec.from_file(str(source.file))
            model = spec.compile()
            data = mujoco.MjData(model)
            mujoco.mj_forward(model, data)
    except (ValueError, RuntimeError) as error:
        raise MjcfError(source.file, f"MuJoCo refuses it: {' '.join(str(error).split())[:300]}") from error
    if model.nflexvert > MOST_VERTICES:
        problem = f"has {model.nflexvert} vertices in its flexes, more than {MOST_VERTICES}; coarsen them"
        raise MjcfError(source.file, problem)
    for name in _CHECKED:
        if not np.isfinite(getattr(model, name)).all():
            problem = f"holds a number that is not finite (in MuJoCo's {name}); correct it"
            raise MjcfError(source.file, problem)
    vertices = _vertices(mujoco, model)
    return CompiledModel(source, mujoco, spec, model, data, vertices, ConversionNotes(), Names())
