"""Compiled static tangent of the `polar` law, rotation of the elements included, into the factor's panels.

With S = F R^T the stretch in world axes, M = tr(S) I - S and gamma = 2 mu - lambda tr(S - I):

    K_ab = V (2 mu (h_a . h_b) I + lambda h_a h_b^T + gamma [h_a]x M^-1 [h_b]x)

Source: Kim and Eberle 2022, Dynamic deformables (eigensystem of corotational energies), in this form.
"""

from __future__ import annotations

from softsim_core.arrays import Array
from softsim_core.dynamics.fast.compile import inlined, kernel
from softsim_core.dynamics.fast.elements import rotate_and_push
from softsim_core.dynamics.fast.kinematics import jacobians, screws
from softsim_core.dynamics.fast.layout import Border, Elements, Motion, Nodes, Work
from softsim_core.dynamics.fast.simd import LANES, add_tangent_block


@inlined
def element_turns(x: Array, elements: Elements, batch: int, lane: int, work: Work) -> None:
    """T_b = gamma M^-1 [h_b]x of one element into rows 3 b .. 3 b + 2 of work.turns (12, 4)."""
    h, r = work.rotated, 4 * lane
    lam, mu = elements.lame[batch, 0, lane], elements.lame[batch, 1, lane]
    s, m = work.one, work.two
    for i in range(3):
        for j in range(3):
            s[i, j] = 0.0
            for a in range(4):
                s[i, j] += x[elements.nodes[batch, a, lane], i] * h[r + a, j]
    trace = s[0, 0] + s[1, 1] + s[2, 2]
    a00, a11, a22 = trace - s[0, 0], trace - s[1, 1], trace - s[2, 2]
    a01, a02, a12 = -0.5 * (s[0, 1] + s[1, 0]), -0.5 * (s[0, 2] + s[2, 0]), -0.5 * (s[1, 2] + s[2, 1])
    c00, c01, c02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
    gamma = (2.0 * mu - lam * (trace - 3.0)) / (a00 * c00 + a01 * c01 + a02 * c02)
    m[0, 0], m[0, 1], m[0, 2] = gamma * c00, gamma * c01, gamma * c02
    m[1, 0], m[1, 1], m[1, 2] = m[0, 1], gamma * (a00 * a22 - a02 * a02), gamma * (a01 * a02 - a00 * a12)
    m[2, 0], m[2, 1], m[2, 2] = m[0, 2], m[1, 2], gamma * (a00 * a11 - a01 * a01)
    for b in range(4):
        for i in range(3):
            row = 3 * b + i
            work.turns[row, 0] = m[i, 1] * h[r + b, 2] - m[i, 2] * h[r + b, 1]
            work.turns[row, 1] = m[i, 2] * h[r + b, 0] - m[i, 0] * h[r + b, 2]
            work.turns[row, 2] = m[i, 0] * h[r + b, 1] - m[i, 1] * h[r + b, 0]


@inlined
def add_element(elements: Elements, batch: int, lane: int, e: int, nodes: Nodes, work: Work) -> None:
    """Add the blocks of element e to the panels, and those of zone nodes to the border."""
    free, moving = elements.counts[e, 0], elements.counts[e, 1]
    lam, mu = elements.lame[batch, 0, lane], elements.lame[batch, 1, lane]
    pair = 0
    for a in range(free):
        for b in range(a, free):
            start, stride = elements.starts[e, pair], elements.strides[e, a]
            add_tangent_block(
                work.panels,
                start,
                stride,
                work.rotated,
                4 * lane + a,
                4 * lane + b,
                lam,
                mu,
                work.turns,
                3 * b,
            )
            pair += 1
    for b in range(free, free + moving):
        z = nodes.zone_number[elements.nodes[batch, b, lane]]
        for q in range(nodes.size[z]):
            add_border_tangent(elements, batch, lane, e, b, z, q, nodes, work)


@inlined
def add_border_tangent(
    elements: Elements, batch: int, lane: int, e: int, b: int, z: int, q: int, nodes: Nodes, work: Work
) -> None:
    """K_ab J for zone node b (number z) of element e, the q-th border unknown of that node and all a."""
    h, t, r, n = work.rotated, work.turns, 4 * lane, 3 * b
    lam, mu = elements.lame[batch, 0, lane], elements.lame[batch, 1, lane]
    free, moving = elements.counts[e, 0], elements.counts[e, 1]
    unknown = nodes.border[z, q]
    j0, j1, j2 = work.jacobian[z, q, 0], work.jacobian[z, q, 1], work.jacobian[z, q, 2]
    b0, b1, b2 = h[r + b, 0], h[r + b, 1], h[r + b, 2]
    along = lam * (b0 * j0 + b1 * j1 + b2 * j2)
    t0 = t[n, 0] * j0 + t[n, 1] * j1 + t[n, 2] * j2
    t1 = t[n + 1, 0] * j0 + t[n + 1, 1] * j1 + t[n + 1, 2] * j2
    t2 = t[n + 2, 0] * j0 + t[n + 2, 1] * j1 + t[n + 2, 2] * j2
    for a in range(free + moving):
        a0, a1, a2 = h[r + a, 0], h[r + a, 1], h[r + a, 2]
        both = 2.0 * mu * (a0 * b0 + a1 * b1 + a2 * b2)
        c0 = both * j0 + along * a0 + a1 * t2 - a2 * t1
        c1 = both * j1 + along * a1 + a2 * t0 - a0 * t2
        c2 = both * j2 + along * a2 + a0 * t1 - a1 * t0
        if a < free:
            stride, supernode = elements.strides[e, a], elements.starts[e, 14 + a]
            place = elements.starts[e, 10 + a] + nodes.border_column[supernode, unknown]
            work.panels[place] += c0
            work.panels[place + stride] += c1
            work.panels[place + 2 * stride] += c2
        else:
            y = nodes.zone_number[elements.nodes[batch, a, lane]]
            for p in range(nodes.size[y]):
                other = nodes.border[y, p]
                if other <= unknown:
                    work.schur[other, unknown] += work.jacobian[y, p, 0] * c0
                    work.schur[other, unknown] += work.jacobian[y, p, 1] * c1
                    work.schur[other, unknown] += work.jacobian[y, p, 2] * c2


@kernel
def add_elements(x: Array, elements: Elements, nodes: Nodes, work: Work) -> None:
    """Forces and tangent of all elements of a kind."""
    for batch in range(len(elements.nodes)):
        rotate_and_push(x, True, elements, batch, work)
        first = batch * LANES
        for lane in range(min(LANES, len(elements.starts) - first)):
            element_turns(x, elements, batch, lane, work)
            add_element(elements, batch, lane, first + lane, nodes, work)


@kernel
def assemble_tangent(
    motion: Motion, external: Array, spring: Array, border: Border, free: Elements, mixed: Elements,
    nodes: Nodes, work: Work,
) -> None:  # fmt: skip
    """The static tangent into panels and border; `external`: all loads but elastic ones (n, 3)."""
    x = motion.positions
    screws(motion, border, work)
    jacobians(motion, nodes, work)
    work.panels[:] = 0.0
    work.schur[:] = 0.0
    work.forces[:] = external
    work.ahead[:] = x
    add_elements(x, free, nodes, work)
    add_elements(x, mixed, nodes, work)
    for f in range(len(nodes.free)):
        for i in range(3):
            work.panels[nodes.row[f] + i * nodes.stride[f] + nodes.column[f] + i] += spring[nodes.free[f]]
    for z in range(len(nodes.zone)):
        add_zone_node(x, z, spring, nodes, work)
    first = len(motion.border_velocities) - len(border.stiffness)
    for j in range(len(border.stiffness)):
        work.schur[first + j, first + j] += border.stiffness[j]


@inlined
def add_zone_node(x: Array, z: int, spring: Array, nodes: Nodes, work: Work) -> None:
    """Into the border: zone node z's soft fixing, and the change of its load's moment as the zone turns."""
    node = nodes.zone[z]
    last = nodes.border[z, nodes.size[z] - 1]
    r0, r1, r2 = (
        x[node, 0] - work.origin[last, 0],
        x[node, 1] - work.origin[last, 1],
        x[node, 2] - work.origin[last, 2],
    )
    f0, f1, f2 = work.forces[node, 0], work.forces[node, 1], work.forces[node, 2]
    along = r0 * f0 + r1 * f1 + r2 * f2
    w = work.angular
    for q in range(nodes.size[z]):
        b = nodes.border[z, q]
        rb = w[b, 0] * r0 + w[b, 1] * r1 + w[b, 2] * r2
        fb = w[b, 0] * f0 + w[b, 1] * f1 + w[b, 2] * f2
        for p in range(q + 1):
            a = nodes.border[z, p]
            ra = w[a, 0] * r0 + w[a, 1] * r1 + w[a, 2] * r2
            fa = w[a, 0] * f0 + w[a, 1] * f1 + w[a, 2] * f2
            both = w[a, 0] * w[b, 0] + w[a, 1] * w[b, 1] + w[a, 2] * w[b, 2]
            work.schur[a, b] += along * both - 0.5 * (ra * fb + fa * rb)
            for i in range(3):
                work.schur[a, b] += spring[node] * work.jacobian[z, p, i] * work.jacobian[z, q, i]
