r"""Corotational linear elasticity on tetrahedra, vectorised over elements: rotations, stress, tangents.

With F the deformation gradient (from the element frame to the world) and R its rotation, the strain is
:math:`\epsilon = sym(F R^T) - I` in world axes, the stress
:math:`\sigma = \lambda tr(\epsilon) I + 2 \mu \epsilon` and the force on node a
:math:`f_a = -V \sigma h_a` with the rotated gradient :math:`h_a = R g_a`.

Sources: Mueller and Gross 2004; Nesme, Payan, Faure 2005 (`qr`); Chao et al. 2010 (exact tangent).
"""

from __future__ import annotations

import numpy as np

from softsim_core.arrays import Array


def unit(vectors: Array) -> Array:
    """Vectors (..., 3) scaled to length one."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def element_frames(corners: Array) -> Array:
    """Frame of each element from its first edge and the plane of its first three nodes.

    Args:
        corners: Corner positions in [m], shape (m, 4, 3).

    Returns:
        Rotations whose columns are the frame axes, shape (m, 3, 3).
    """
    first = unit(corners[:, 1] - corners[:, 0])
    third = unit(np.cross(first, corners[:, 2] - corners[:, 0]))
    return np.stack([first, np.cross(third, first), third], axis=-1)


def polar_rotations(deformation: Array) -> Array:
    """Nearest proper rotation to each deformation gradient (m, 3, 3); inverted elements included."""
    u, _, vt = np.linalg.svd(deformation)
    u[:, :, 2] *= np.linalg.det(u @ vt)[:, None]  # flip the direction of least stretch, never mirror
    return np.asarray(u @ vt)


def deformation_gradients(corners: Array, gradients: Array) -> Array:
    """F (m, 3, 3) of corner positions (m, 4, 3) in [m] and shape gradients (m, 4, 3) in [1/m]."""
    return np.asarray(np.einsum("mai,maj->mij", corners, gradients))


def element_rotations(corners: Array, gradients: Array, law: str) -> Array:
    """Rotation of each element by the law "polar" or "qr", shape (m, 3, 3)."""
    if law == "qr":
        return element_frames(corners)
    return polar_rotations(deformation_gradients(corners, gradients))


def stresses(corners: Array, rotated: Array, lame: Array) -> Array:
    """Cauchy-like stress in world axes.

    Args:
        corners: Corner positions in [m], shape (m, 4, 3).
        rotated: Rotated gradients h in [1/m], shape (m, 4, 3).
        lame: Lame parameters (lambda, mu) in [Pa], shape (m, 2).

    Returns:
        Stress in [Pa], symmetric, shape (m, 3, 3).
    """
    return _stress(np.einsum("mai,maj->mij", corners, rotated) - np.eye(3), lame)


def stiffness_blocks(rotated: Array, volumes: Array, lame: Array) -> Array:
    """Warped K_ab = V (lambda h_a h_b^T + mu h_b h_a^T + mu (h_a . h_b) I), shape (m, 4, 4, 3, 3)."""
    outer = np.einsum("mai,mbj->mabij", rotated, rotated)
    dots = np.einsum("mai,mbi->mab", rotated, rotated)
    lam, mu = (lame * volumes[:, None]).T
    blocks = lam[:, None, None, None, None] * outer
    blocks += mu[:, None, None, None, None] * np.swapaxes(outer, 3, 4)
    blocks += mu[:, None, None, None, None] * dots[..., None, None] * np.eye(3)
    return np.asarray(blocks)


def exact_tangent_blocks(corners: Array, gradients: Array, volumes: Array, lame: Array, law: str) -> Array:
    r"""Exact derivative -df_a/dx_b of the law "polar" or "qr", rotation included, shape (m, 4, 4, 3, 3).

    A variation :math:`\delta F` turns the rotation by :math:`\delta R = R [w]_x`. Symmetric for `polar`,
    whose force has a potential, not for `qr`; singular for `polar` where two principal stretches cancel.
    """
    rotation = element_rotations(corners, gradients, law)
    rt = np.swapaxes(rotation, 1, 2)
    stretch = rt @ deformation_gradients(corners, gradients)
    turns = _polar_turns(stretch, rt, gradients) if law == "polar" else _frame_turns(corners, rt)
    turn = cross_matrices(turns.reshape(-1, 3)).reshape(*turns.shape[:3], 3, 3)
    move = np.einsum("mij,mbk->mbjik", rt, gradients)  # R^T dF for a unit move of node b along axis j
    d_stress = _stress(move - turn @ stretch[:, None, None], lame[:, None, None])
    stress = _stress(stretch - np.eye(3), lame)
    d_force = (volumes[:, None, None] * rotation)[:, None, None] @ (turn @ stress[:, None, None] + d_stress)
    return np.asarray(np.einsum("mbjik,mak->mabij", d_force, gradients))


def _stress(gradient: Array, lame: Array) -> Array:
    """Stress (..., 3, 3) of a displacement gradient (..., 3, 3), Lame parameters (..., 2) in [Pa]."""
    strain = 0.5 * (gradient + np.swapaxes(gradient, -1, -2))
    trace = np.trace(strain, axis1=-2, axis2=-1)[..., None, None]
    return np.asarray(lame[..., :1, None] * trace * np.eye(3) + 2.0 * lame[..., 1:, None] * strain)


def _polar_turns(stretch: Array, rt: Array, gradients: Array) -> Array:
    """Turn w, (tr(S) I - S) w = axial(R^T dF), for a unit move of node b along axis j, shape (m, 4, 3, 3)."""
    resist = np.trace(stretch, axis1=1, axis2=2)[:, None, None] * np.eye(3) - stretch
    axial = np.cross(gradients[:, :, None, :], np.swapaxes(rt, 1, 2)[:, None, :, :])
    return np.asarray(np.einsum("mij,mbkj->mbki", np.linalg.inv(resist), axial))


def _frame_turns(corners: Array, rt: Array) -> Array:
    """Turn w of the frame of the first edge d and the second e for a unit move of node b along axis j."""
    edges = np.einsum(
        "mij,maj->mai", rt, corners[:, 1:3] - corners[:, :1]
    )  # in the frame: (l, 0, 0), (p, q, 0)
    length, p, q = edges[:, 0, 0], edges[:, 1, 0], edges[:, 1, 1]
    turns = np.zeros((len(corners), 4, 3, 3))
    for b, first, second in ((0, -1.0, -1.0), (1, 1.0, 0.0), (2, 0.0, 1.0)):
        y, z = rt[:, 1], rt[:, 2]  # components of the unit moves along the frame's axes
        turns[:, b, :, 0] = (second / q - first * p / (length * q))[:, None] * z
        turns[:, b, :, 1] = -first / length[:, None] * z
        turns[:, b, :, 2] = first / length[:, None] * y
    return turns


def cross_matrices(vectors: Array) -> Array:
    """[v]x of each vector, (m, 3) -> (m, 3, 3)."""
    result = np.zeros((len(vectors), 3, 3))
    result[:, 0, 1], result[:, 0, 2], result[:, 1, 2] = -vectors[:, 2], vectors[:, 1], -vectors[:, 0]
    return result - np.swapaxes(result, 1, 2)


def von_mises(stress: Array) -> Array:
    """Von Mises stress in [Pa], shape (m,), of stress tensors (m, 3, 3)."""
    deviator = stress - np.trace(stress, axis1=1, axis2=2)[:, None, None] / 3.0 * np.eye(3)
    return np.asarray(np.sqrt(1.5 * np.einsum("mij,mij->m", deviator, deviator)))
