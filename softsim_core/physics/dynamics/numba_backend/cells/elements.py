"""Compiled assembly of linear tetrahedra: forces, and stiffness directly into the factor's panels.

Arrays of a batch are laid out lane by lane: gradients (batches, 12, LANES), nodes (batches, 4, LANES). The
formulas are written in ordinary arithmetic on `Lanes`; they are those of fem.materials.corotational.

The loops over elements work on arrays that are taken out of their tuples before. If a tuple were passed
inside the loop, Numba would count references to each of its arrays in every iteration, which takes as long as
the work.
"""

from __future__ import annotations

from math import sqrt
from typing import Any, cast

import numpy as np
from llvmlite import ir
from numba import types

from softsim_core.base import Array, IndexArray
from softsim_core.physics.dynamics.numba_backend import Elements, Nodes, Work, kernel
from softsim_core.physics.dynamics.numba_backend.cells.corotational import rotate_lanes, twist_stiffness
from softsim_core.physics.dynamics.numba_backend.cells.lanes import (
    Batch,
    Lanes,
    Matrix,
    Triple,
    cross,
    difference,
    dot,
    times,
    unit,
)
from softsim_core.physics.fem.materials import FLAT
from softsim_core.physics.linalg import LANES, Vectors, add_block, intrinsic

HALLEY_STEPS = 3
"""Number of Halley steps to the root in the polar rotation of a batch; each triples the digits."""

LAST_STEP = 1e-6
"""A lane with a larger last step, relative to the root, is recomputed by the scalar kernel."""


@intrinsic
def frame_rotations(typing: Any, x: Any, corners: Any, batch: Any, rotations: Any) -> Any:
    """Compute rotations (9, LANES) of a batch from the frames of three corners (law `corotational_qr`)."""
    signature = types.void(x, corners, types.int64, rotations)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b = Batch(context, builder)
        positions, index = b.v.data(signature.args[0], args[0]), b.v.data(signature.args[1], args[1])
        out = b.v.data(signature.args[3], args[3])
        first, second, third, _ = b.nodes(index, builder.mul(args[2], args[2].type(4 * LANES)))
        origin = b.gather(positions, first)
        e_x = unit(difference(b.gather(positions, second), origin))
        e_z = unit(cross(e_x, difference(b.gather(positions, third), origin)))
        e_y = cross(e_z, e_x)
        for i in range(3):
            for j, axis in enumerate((e_x, e_y, e_z)):
                b.put(out, 3 * i + j, axis[i])
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def polar_rotations(
    typing: Any, x: Any, nodes: Any, gradients: Any, batch: Any, deformation: Any, rotations: Any
) -> Any:
    """Compute deformation gradients and nearest rotations of a batch, each (9, LANES) (law `corotational`).

    Return the lanes, one bit each, that are left to the scalar kernel: the root was not found, or the
    rotation is nearly undefined. Source: Markley 1993, see corotational.nearest_rotation; here by Halley's
    method.
    """
    signature = types.int64(x, nodes, gradients, types.int64, deformation, rotations)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        b = Batch(context, builder)
        positions, index, slopes = (b.v.data(signature.args[i], args[i]) for i in range(3))
        out_f, out = b.v.data(signature.args[4], args[4]), b.v.data(signature.args[5], args[5])
        batch, integer = args[3], args[3].type
        places = b.nodes(index, builder.mul(batch, integer(4 * LANES)))
        g = b.rows(slopes, builder.mul(batch, integer(12 * LANES)), 12)
        corners = [b.gather(positions, place) for place in places]
        f = [
            [
                corners[0][i] * g[j]
                + corners[1][i] * g[3 + j]
                + corners[2][i] * g[6 + j]
                + corners[3][i] * g[9 + j]
                for j in range(3)
            ]
            for i in range(3)
        ]
        cofactor = [cross(f[1], f[2]), cross(f[2], f[0]), cross(f[0], f[1])]
        det = dot(f[0], cofactor[0])
        cc = dot(cofactor[0], cofactor[0]) + dot(cofactor[1], cofactor[1]) + dot(cofactor[2], cofactor[2])
        ff = dot(f[0], f[0]) + dot(f[1], f[1]) + dot(f[2], f[2])
        k = (ff * 3.0).root()
        step, eight, four = k, det * 8.0, cc * 4.0
        for _ in range(HALLEY_STEPS):
            p = k * k - ff
            value, slope = p * p - (k * eight + four), k * p * 4.0 - eight
            bend = p * 2.0 + k * k * 4.0  # half the second derivative
            step = (value * slope) / (slope * slope - value * bend)
            k = k - step
        a = (k * k - ff) * 0.5
        denominator = a * k - det
        share = a + ff
        over = (k * 0.0 + 1.0) / denominator
        square = [[dot(f[i], f[n]) for n in range(i + 1)] for i in range(3)]
        for i in range(3):
            row = [square[max(i, n)][min(i, n)] for n in range(3)]
            for j in range(3):
                triple = row[0] * f[0][j] + row[1] * f[1][j] + row[2] * f[2][j]
                b.put(out, 3 * i + j, (share * f[i][j] + k * cofactor[i][j] - triple) * over)
                b.put(out_f, 3 * i + j, f[i][j])
        weak = denominator.below(k * k * k * 1e-3)
        late = (k * LAST_STEP).below((step * step).root())
        bits = builder.bitcast(builder.or_(weak, late), ir.IntType(LANES))
        return builder.zext(bits, ir.IntType(64))

    return signature, generate


def strain(w: Matrix) -> Matrix:
    """Return sym(w) - I."""
    return [[w[i][i] - 1.0 if i == j else (w[i][j] + w[j][i]) * 0.5 for j in range(3)] for i in range(3)]


def stress(w: Matrix, lam: Lanes, mu: Lanes) -> Matrix:
    """Return lam tr(E) I + 2 mu E with E = sym(w) - I."""
    normal = [w[i][i] - 1.0 for i in range(3)]
    pressure = lam * (normal[0] + normal[1] + normal[2])
    double = mu * 2.0
    return [
        [pressure + double * normal[i] if i == j else mu * (w[i][j] + w[j][i]) for j in range(3)]
        for i in range(3)
    ]


def put_blocks(b: Batch, out: Any, h: list[Triple], lam: Lanes, mu: Lanes, twist: Matrix | None) -> None:
    """Write K_ab for a <= b, with the twist D.

    K_ab = lam h_a h_b^T + mu h_b h_a^T + mu (h_a . h_b) I + [h_a]x D [h_b]x
    """
    pair = [[4 * a - a * (a - 1) // 2 + n - a for n in range(4)] for a in range(4)]
    for n in range(4):
        lam_h, mu_h = [lam * each for each in h[n]], [mu * each for each in h[n]]
        turned = None if twist is None else [cross(row, h[n]) for row in twist]
        for a in range(n + 1):
            both = dot(h[a], mu_h)
            for i in range(3):
                row = [h[a][i] * lam_h[j] + h[a][j] * mu_h[i] for j in range(3)]
                row[i] = row[i] + both
                if turned is not None:
                    after, before = (i + 1) % 3, (i + 2) % 3
                    row = [
                        entry + (h[a][after] * turned[before][j] - h[a][before] * turned[after][j])
                        for j, entry in enumerate(row)
                    ]
                b.put_rows(out, 4 * LANES * (3 * pair[a][n] + i), row)


def _batch(frozen: bool) -> Any:
    """Return an intrinsic for the forces and stiffness of a batch, with frozen or with turning rotations."""

    @intrinsic
    def batch(
        typing: Any, y: Any, exact: Any, scale: Any, nodes: Any, gradients: Any, lame: Any, batch: Any,
        deformation: Any, rotations: Any, forces: Any, blocks: Any,
    ) -> Any:  # fmt: skip
        """Subtract the elastic forces f(x) - K (y - x) of a batch; put the blocks of scale K_ab, a <= b.

        x are the positions at which `deformation` and `rotations` were taken. blocks: row 3 pair + i of every
        lane, four numbers each with a zero at the end, shape (30, LANES, 4); pairs run 00, 01, ... 33.
        """
        signature = types.void(
            y, types.boolean, types.float64, nodes, gradients, lame, types.int64, deformation, rotations,
            forces, blocks,
        )  # fmt: skip

        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            b = Batch(context, builder)
            positions, index, slopes, moduli = (b.v.data(signature.args[i], args[i]) for i in (0, 3, 4, 5))
            gradient, turn, total, out = (b.v.data(signature.args[i], args[i]) for i in (7, 8, 9, 10))
            batch, integer = args[6], args[6].type
            places = b.nodes(index, builder.mul(batch, integer(4 * LANES)))
            g = b.rows(slopes, builder.mul(batch, integer(12 * LANES)), 12)
            numbers = b.rows(turn, integer(0), 9)
            r = [numbers[3 * i : 3 * i + 3] for i in range(3)]
            lam, mu = b.rows(moduli, builder.mul(batch, integer(2 * LANES)), 2)
            h = [times(r, g[3 * n : 3 * n + 3]) for n in range(4)]
            corners = [b.gather(positions, place) for place in places]
            w = [
                [
                    sum((corners[n][i] * h[n][j] for n in range(1, 4)), corners[0][i] * h[0][j])
                    for j in range(3)
                ]
                for i in range(3)
            ]
            s = stress(w, lam, mu)
            twist: Matrix | None = None
            if not frozen:
                numbers = b.rows(gradient, integer(0), 9)
                before = [times(r, numbers[3 * i : 3 * i + 3]) for i in range(3)]
                twist = twist_stiffness(strain(before), lam, mu, args[1])
                moved = [difference(w[i], before[i]) for i in range(3)]
                z = times(twist, [moved[k][j] - moved[j][k] for j, k in ((1, 2), (2, 0), (0, 1))])
                for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
                    s[j][k] = s[j][k] + z[i]
                    s[k][j] = s[k][j] - z[i]
            for n in range(4):
                b.subtract(total, places[n], times(s, h[n]))
            factor = Lanes(b.v, b.v.splat(args[2]))
            if twist is not None:
                twist = [[each * factor for each in row] for row in twist]
            put_blocks(b, out, h, lam * factor, mu * factor, twist)
            return context.get_dummy_value()

        return signature, generate

    return batch


frozen_batch = _batch(frozen=True)
turning_batch = _batch(frozen=False)


@intrinsic
def add_element(typing: Any, panels: Any, starts: Any, strides: Any, e: Any, blocks: Any, lane: Any) -> Any:
    """Add the ten blocks of element e, whose nodes are all free, to the panels; see layout.Elements."""
    signature = types.void(panels, starts, strides, types.int64, blocks, types.int64)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        v = Vectors(context, builder, 4)
        values, numbers = v.data(signature.args[0], args[0]), v.data(signature.args[4], args[4])
        index, widths = v.data(signature.args[1], args[1]), v.data(signature.args[2], args[2])
        e, lane, integer = args[3], args[5], args[3].type
        first = v.at(numbers, builder.mul(lane, integer(4)))
        start, stride = v.at(index, builder.mul(e, integer(18))), v.at(widths, builder.mul(e, integer(4)))
        pair = 0
        for a in range(4):
            width = builder.load(v.at(stride, integer(a)))
            for _ in range(a, 4):
                goal = v.at(values, builder.load(v.at(start, integer(pair))))
                for i in range(3):
                    block = v.load(v.at(first, integer(4 * LANES * (3 * pair + i))))
                    v.store(v.add(v.load(goal), block), goal)
                    goal = v.at(goal, width)
                pair += 1
        return context.get_dummy_value()

    return signature, generate


FROZEN, CLAMPED, EXACT = (cast(int, np.int64(tangent)) for tangent in range(3))
"""Tangents of an element: of `corotational_qr` with its rotation frozen; of `corotational` with negative
eigenvalues set to zero, for a step; of `corotational` unchanged, for an equilibrium.

They have one integer type, because Numba would compile all kernels once more for each literal.
"""

ROW = 4 * LANES
"""Numbers in a row of a batch's blocks, all lanes together."""


@kernel
def assemble_free(x: Array, scale: float, tangent: int, elements: Elements, work: Work) -> None:
    """Add elements with four free nodes: forces at work.ahead, and `scale` times the stiffness at x."""
    corners, ids, gradients, lame = elements.corners, elements.nodes, elements.gradients, elements.lame
    starts, strides, panels = elements.starts, elements.strides, work.factor.panels
    deformation, rotations, blocks = work.deformation, work.rotations, work.blocks
    ahead, forces = work.ahead, work.forces
    for batch in range(len(ids)):
        if tangent == FROZEN:
            frame_rotations(x, corners, batch, rotations)
            frozen_batch(
                ahead, False, scale, ids, gradients, lame, batch, deformation, rotations, forces, blocks
            )
        else:
            left = polar_rotations(x, ids, gradients, batch, deformation, rotations)
            if left:
                rotate_lanes(left, deformation, rotations)
            turning_batch(
                ahead, tangent == EXACT, scale, ids, gradients, lame, batch, deformation, rotations, forces,
                blocks,
            )  # fmt: skip
        first = batch * LANES
        for lane in range(min(LANES, len(starts) - first)):
            add_element(panels, starts, strides, first + lane, blocks, lane)


@kernel
def assemble_mixed(
    x: Array, scale: float, tangent: int, elements: Elements, nodes: Nodes, work: Work
) -> None:
    """Add elements with nodes in rigid regions; the part of these nodes goes to the reduced coordinates."""
    corners, ids, gradients, lame = elements.corners, elements.nodes, elements.gradients, elements.lame
    starts, strides, panels, counts = elements.starts, elements.strides, work.factor.panels, elements.counts
    deformation, rotations, k = work.deformation, work.rotations, work.blocks
    ahead, forces, jacobian, schur = work.ahead, work.forces, work.jacobian, work.factor.schur
    region_number, size, reduced, column = (
        nodes.region_number,
        nodes.size,
        nodes.reduced,
        nodes.reduced_column,
    )
    for batch in range(len(ids)):
        if tangent == FROZEN:
            frame_rotations(x, corners, batch, rotations)
            frozen_batch(ahead, False, scale, ids, gradients, lame, batch, deformation, rotations, forces, k)
        else:
            left = polar_rotations(x, ids, gradients, batch, deformation, rotations)
            if left:
                rotate_lanes(left, deformation, rotations)
            turning_batch(
                ahead, tangent == EXACT, scale, ids, gradients, lame, batch, deformation, rotations, forces, k
            )
        first = batch * LANES
        for lane in range(min(LANES, len(starts) - first)):
            e = first + lane
            free, moving = counts[e, 0], counts[e, 1]
            pair = 0
            for a in range(free):
                row = 3 * (4 * a - a * (a - 1) // 2)
                for b in range(a, free):
                    place = ROW * (row + 3 * (b - a)) + 4 * lane
                    add_block(panels, starts[e, pair], strides[e, a], k, place, ROW)
                    pair += 1
            for b in range(free, free + moving):
                z = region_number[ids[batch, b, lane]]
                for q in range(size[z]):  # K_ab J for all a, J the q-th reduced coordinate of region node b
                    unknown = reduced[z, q]
                    j0, j1, j2 = jacobian[z, q, 0], jacobian[z, q, 1], jacobian[z, q, 2]
                    for a in range(free + moving):
                        low, high = min(a, b), max(a, b)
                        row = 3 * (4 * low - low * (low - 1) // 2 + high - low)
                        if a <= b:
                            c0 = k[row, lane, 0] * j0 + k[row, lane, 1] * j1 + k[row, lane, 2] * j2
                            c1 = (
                                k[row + 1, lane, 0] * j0 + k[row + 1, lane, 1] * j1 + k[row + 1, lane, 2] * j2
                            )
                            c2 = (
                                k[row + 2, lane, 0] * j0 + k[row + 2, lane, 1] * j1 + k[row + 2, lane, 2] * j2
                            )
                        else:
                            c0 = k[row, lane, 0] * j0 + k[row + 1, lane, 0] * j1 + k[row + 2, lane, 0] * j2
                            c1 = k[row, lane, 1] * j0 + k[row + 1, lane, 1] * j1 + k[row + 2, lane, 1] * j2
                            c2 = k[row, lane, 2] * j0 + k[row + 1, lane, 2] * j1 + k[row + 2, lane, 2] * j2
                        if a < free:
                            stride = strides[e, a]
                            place = starts[e, 10 + a] + column[starts[e, 14 + a], unknown]
                            panels[place] += c0
                            panels[place + stride] += c1
                            panels[place + 2 * stride] += c2
                            continue
                        other = region_number[ids[batch, a, lane]]
                        for p in range(size[other]):
                            m = reduced[other, p]
                            if m <= unknown:
                                schur[m, unknown] += (
                                    jacobian[other, p, 0] * c0
                                    + jacobian[other, p, 1] * c1
                                    + jacobian[other, p, 2] * c2
                                )


@kernel
def assemble_nodes(v: Array, h: float, rayleigh_mass: float, nodes: Nodes, work: Work) -> None:
    """Add masses, soft fixings and right-hand side; work.forces has all node forces but mass damping."""
    impulse = np.empty(3)
    for f in range(len(nodes.free)):
        node, place, stride = nodes.free[f], nodes.row[f], nodes.stride[f]
        for i in range(3):
            row = place + i * stride
            work.factor.panels[row + nodes.column[f] + i] += nodes.diagonal[node]
            damping = rayleigh_mass * nodes.mass[node] * v[node, i]
            work.factor.panels[row + nodes.right[f]] = h * (work.forces[node, i] - damping)
    last = work.factor.schur.shape[1] - 1
    for z in range(len(nodes.region)):
        node = nodes.region[z]
        for i in range(3):
            impulse[i] = h * (work.forces[node, i] - rayleigh_mass * nodes.mass[node] * v[node, i])
        for q in range(nodes.size[z]):
            k = nodes.reduced[z, q]
            for i in range(3):
                jacobian = work.jacobian[z, q, i]
                work.factor.schur[k, last] += jacobian * impulse[i]
                for p in range(q + 1):
                    work.factor.schur[nodes.reduced[z, p], k] += (
                        nodes.diagonal[node] * jacobian * work.jacobian[z, p, i]
                    )


@kernel
def von_mises_stress(
    x: Array, polar: bool, elements: Elements, ids: IndexArray, moduli: Array, work: Work, result: Array
) -> None:
    """Write the von Mises stress in [Pa] of elements with the numbers `ids` (e,) into `result` (m,).

    `moduli` (m, 2) are the Lame parameters in [Pa] by element number.
    """
    w, cauchy, f = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for batch in range(len(elements.nodes)):
        if polar:
            left = polar_rotations(
                x, elements.nodes, elements.gradients, batch, work.deformation, work.rotations
            )
            if left:
                rotate_lanes(left, work.deformation, work.rotations)
        else:
            frame_rotations(x, elements.corners, batch, work.rotations)
        first = batch * LANES
        for lane in range(min(LANES, len(ids) - first)):
            for i in range(3):
                for j in range(3):
                    f[j] = 0.0
                    for a in range(4):
                        f[j] += (
                            x[elements.nodes[batch, a, lane], i] * elements.gradients[batch, 3 * a + j, lane]
                        )
                for j in range(3):
                    w[i, j] = 0.0
                    for k in range(3):
                        w[i, j] += f[k] * work.rotations[3 * j + k, lane]
            lam, mu = moduli[ids[first + lane]]
            pressed = lam * (w[0, 0] + w[1, 1] + w[2, 2] - 3.0) - 2.0 * mu
            for i in range(3):  # det F times the Cauchy stress: sigma W^T with W = F R^T
                for j in range(3):
                    cauchy[i, j] = pressed * w[j, i]
                    for k in range(3):
                        cauchy[i, j] += mu * (w[i, k] + w[k, i]) * w[j, k]
            volume = 0.0
            for i in range(3):
                j, k = (i + 1) % 3, (i + 2) % 3
                volume += w[0, i] * (w[1, j] * w[2, k] - w[1, k] * w[2, j])
            e0, e1, e2 = cauchy[0, 0], cauchy[1, 1], cauchy[2, 2]
            normal = (e0 - e1) ** 2 + (e1 - e2) ** 2 + (e2 - e0) ** 2
            shear = (cauchy[0, 1] + cauchy[1, 0]) ** 2
            shear += (cauchy[1, 2] + cauchy[2, 1]) ** 2 + (cauchy[0, 2] + cauchy[2, 0]) ** 2
            result[ids[first + lane]] = sqrt(0.5 * normal + 0.75 * shear) / max(abs(volume), FLAT)
