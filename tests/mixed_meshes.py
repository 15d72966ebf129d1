"""Random meshes of hexahedra, wedges, pyramids and tetrahedra, as files hold them."""

from __future__ import annotations

import itertools

import meshio
import numpy as np

CELLS = 3
CORNERS = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))
QUADS = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))
KUHN = ((0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6))
WEDGES = ((0, 1, 2, 4, 5, 6), (0, 2, 3, 4, 6, 7))
KINDS = ("hexahedron", "wedge", "pyramid", "tetra")


def mixed(seed: int, kinds: tuple[str, ...] = KINDS) -> meshio.Mesh:
    """A cube of 1 m with 27 places for cells of random kinds; inner nodes are moved, numbers shuffled."""
    random = np.random.default_rng(seed)
    count = CELLS + 1
    points = np.array(list(itertools.product(range(count), repeat=3)), dtype=float) / CELLS
    inner = ((points > 0.0) & (points < 1.0)).all(axis=1)
    points[inner] += random.uniform(-0.04, 0.04, (inner.sum(), 3))
    extra: list[np.ndarray] = []
    blocks: dict[str, list[list[int]]] = {}
    for place in itertools.product(range(CELLS), repeat=3):
        steps = np.array(place) + CORNERS
        cell = (steps @ [count**2, count, 1]).tolist()
        kind = str(random.choice(kinds))
        if kind == "hexahedron":
            blocks.setdefault(kind, []).append(cell)
        elif kind == "pyramid":
            apex = len(points) + len(extra)
            extra.append(points[cell].mean(axis=0))
            blocks.setdefault(kind, []).extend([*(cell[k] for k in quad), apex] for quad in QUADS)
        else:
            parts = WEDGES if kind == "wedge" else KUHN
            blocks.setdefault(kind, []).extend([cell[k] for k in part] for part in parts)
    points = np.concatenate([points, np.array(extra).reshape(-1, 3)])
    order = random.permutation(len(points))  # the new number of each node
    shuffled = np.empty_like(points)
    shuffled[order] = points
    return meshio.Mesh(shuffled, [(kind, order[np.array(rows)]) for kind, rows in blocks.items()])
