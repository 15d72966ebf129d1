"""Carriers of a MuJoCo model's bodies in a scene: the world, a joint, a free frame, or the body itself."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from softsim_core.base import Array, Placement, Vector
from softsim_core.mjcf.reading import CompiledModel
from softsim_core.physics.mechanics import JointLimits, euler_of, rotation_exp
from softsim_core.scene import Colour, JointDescription

Kind: TypeAlias = Literal["world", "joint", "frame", "free"]


@dataclass(frozen=True, slots=True, eq=False)
class Carrier:
    """The part that moves a body.

    Attributes:
        kind: The world, a joint, a free frame that soft bodies share, or the body itself.
        name: Name of the joint, the frame or the rigid body.
        body: MuJoCo's number of the moving body.
        origin, rotation: Initial pose of its frame, in [m], shapes (3,) and (3, 3).
    """

    kind: Kind
    name: str
    body: int
    origin: Array
    rotation: Array


def vector(values: Array) -> Vector:
    """Convert three numbers to the form of a description; rounding errors of 1e-15 are removed."""
    x, y, z = (float(f"{each:.12g}") if abs(each) > 1e-15 else 0.0 for each in np.asarray(values).tolist())
    return x, y, z


def colour(rgba: Array) -> Colour:
    """Convert a colour to the form of a description."""
    red, green, blue, alpha = (min(1.0, max(0.0, round(float(each), 4))) for each in rgba)
    return red, green, blue, alpha


def placement(position: Array, rotation: Array) -> Placement:
    """Convert a pose to the form of a description."""
    return Placement(translation=vector(position), rotation_deg=vector(np.degrees(euler_of(rotation))))


def carriers(loaded: CompiledModel) -> tuple[dict[int, Carrier], tuple[JointDescription, ...]]:
    """Return the carrier of each body except flex vertices, and the joints that move some of them."""
    m, notes = loaded.model, loaded.notes
    world = Carrier("world", "world", 0, np.zeros(3), np.eye(3))
    found, joints = {0: world}, list[JointDescription]()
    for b in range(1, m.nbody):
        if loaded.is_vertex(b):
            continue
        carrier = found.get(int(m.body_parentid[b]), world)
        if m.body_mocapid[b] >= 0:
            notes.say(f"body {m.body(b).name}", "mocap: it stays where it starts")
        for j in range(m.body_jntadr[b], m.body_jntadr[b] + m.body_jntnum[b]):
            carrier = _add_joint(loaded, b, j, carrier, joints)
        found[b] = carrier
    return found, tuple(joints)


def _add_joint(
    loaded: CompiledModel, b: int, j: int, below: Carrier, joints: list[JointDescription]
) -> Carrier:
    """Return the carrier of a body after one more of its joints."""
    m, d, notes, kinds = loaded.model, loaded.data, loaded.notes, loaded.mujoco.mjtJoint
    called, kind = f"joint {m.jnt(j).name or j} of body {m.body(b).name or b}", m.jnt_type[j]
    place, turn = np.array(d.xpos[b]), np.array(d.xmat[b]).reshape(3, 3)
    if kind == kinds.mjJNT_FREE:
        soft = [f for f in range(m.nflex) if not loaded.refusal(f)]
        pinned = any((m.body_weldid[loaded.flex_bodies(f)] == b).any() for f in soft)
        name = loaded.names.new(m.body(b).name, "body")
        return Carrier("frame" if pinned else "free", name, b, place, turn)
    if kind == kinds.mjJNT_BALL:
        notes.say(called, "type ball is not taken over: the body does not turn about it")
        return below
    if below.kind in ("free", "frame"):
        notes.say(called, "hangs on a body that moves freely: it is not taken over, both move as one")
        return below
    name = loaded.names.new(m.jnt(j).name, "joint")
    hinge = kind == kinds.mjJNT_HINGE
    axis, anchor = np.array(d.xaxis[j]), np.array(d.xanchor[j])
    start = float(m.qpos0[m.jnt_qposadr[j]])
    joints.append(
        JointDescription(
            name=name,
            kind="revolute" if hinge else "prismatic",
            parent=below.name if below.kind == "joint" else None,
            base=Placement(translation=vector(anchor - (0.0 if hinge else start) * axis)),
            axis=vector(axis / np.linalg.norm(axis)),
            limits=JointLimits(*m.jnt_range[j].tolist()) if m.jnt_limited[j] else JointLimits(),
            rest=start,
            **_drive(loaded, j, called),
        )
    )
    return Carrier("joint", name, b, anchor, rotation_exp(start * axis) if hinge else np.eye(3))


def _drive(loaded: CompiledModel, j: int, called: str) -> dict[str, Any]:
    """Return stiffness and inertia of a joint: of a position servo, of a spring, or none."""
    m, notes = loaded.model, loaded.notes
    own = float(m.jnt_stiffness[j]) if np.ndim(m.jnt_stiffness[j]) == 0 else float(m.jnt_stiffness[j][0])
    of_joint = m.actuator_trntype == loaded.mujoco.mjtTrn.mjTRN_JOINT
    servos = of_joint & (m.actuator_trnid[:, 0] == j) & (m.actuator_biasprm[:, 1] < 0.0)
    servo = int(np.argmax(servos)) if servos.any() else None
    stiffness = own
    if servo is not None:
        gear = float(m.actuator_gear[servo, 0])
        stiffness = -float(m.actuator_biasprm[servo, 1]) * gear**2
        if own > 0.0:
            notes.say(called, "stiffness is not taken over beside that of its position actuator")
        if not math.isclose(gear, 1.0):
            notes.say(called, "gear of its actuator is in the stiffness; commands are positions of the joint")
    elif own > 0.0:
        start = float(m.qpos0[m.jnt_qposadr[j]])
        if not math.isclose(float(m.qpos_spring[m.jnt_qposadr[j]]), start, abs_tol=1e-9):
            notes.say(called, "springref is not taken over: the spring is at rest where the model starts")
    if not stiffness > 0.0:
        notes.say(called, "turns or slides freely in MuJoCo; here it stays where it is commanded")
        return {}
    return {"stiffness": stiffness, "inertia": float(f"{_inertia(loaded, j):.9g}")}


def _inertia(loaded: CompiledModel, j: int) -> float:
    """Return the initial inertia in [kg m^2] or [kg] of what a joint moves, without soft bodies."""
    m, d = loaded.model, loaded.data
    axis, anchor = np.array(d.xaxis[j]), np.array(d.xanchor[j])
    moved, total = {int(m.jnt_bodyid[j])}, float(m.dof_armature[m.jnt_dofadr[j]])
    hinge = m.jnt_type[j] == loaded.mujoco.mjtJoint.mjJNT_HINGE
    weight = 0.0
    for b in range(1, m.nbody):
        if int(m.body_parentid[b]) in moved:
            moved.add(b)
        if b not in moved or loaded.is_vertex(b):
            continue
        mass, turn = float(m.body_mass[b]), np.array(d.ximat[b]).reshape(3, 3)
        weight += mass
        if hinge:
            arm = np.cross(axis, np.array(d.xipos[b]) - anchor)
            total += float(axis @ turn @ np.diag(m.body_inertia[b]) @ turn.T @ axis) + mass * float(arm @ arm)
        else:
            total += mass
    if weight > 0.0 and np.any(np.array(m.opt.gravity)):
        called = f"body {m.body(m.jnt_bodyid[j]).name or m.jnt_bodyid[j]}"
        loaded.notes.say(called, f"mass {weight:.4g} kg on a joint has inertia here, but no weight")
    return total
