"""Pictures of simulated robots: triangles into pixels, with light, shadow and silicone that is lit through.

A plain rasteriser with a depth buffer, made twice as large as wanted and shrunk, so that edges are smooth.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from PIL import Image, ImageFilter
from scipy.sparse import csr_matrix

from softsim_core.base import Array, IndexArray

OVERSAMPLED = 2
CREASE = np.cos(np.radians(38.0))
"""Faces that turn by less are drawn as one smooth surface."""

SUN = np.array([0.42, -0.38, 0.82]) / np.linalg.norm([0.42, -0.38, 0.82])
SKY, GROUND = np.array([1.0, 1.02, 1.06]), np.array([0.62, 0.58, 0.56])
TOP, BOTTOM = np.array([0.955, 0.965, 0.975]), np.array([0.83, 0.855, 0.885])
SHADOW = np.array([0.50, 0.54, 0.62])


@dataclass
class Surface:
    """Triangles of one look.

    Attributes:
        points: Vertices in [m], shape (n, 3).
        triangles: Vertices of each, outwards anticlockwise, shape (m, 3).
        colour: Red, green, blue in [0, 1].
        depth: Length in [m] on which light is absorbed to a third; 0: opaque.
        gloss: Share of light that is mirrored.
        smooth: Which faces lend each corner their normals, from `neighbours`; None: flat ones.
    """

    points: Array
    triangles: IndexArray
    colour: tuple[float, float, float]
    depth: float = 0.0
    gloss: float = 0.25
    smooth: csr_matrix | None = None


@dataclass
class Camera:
    """A camera that looks at the middle of what it has to show.

    Attributes:
        around: Points in [m] that must be seen, shape (k, 3).
        azimuth, elevation: Direction to the camera in [deg].
        size: Width and height of the picture in pixels.
        margin: Share of the picture that stays free around them.
        floor: Height of the floor in [m].
    """

    around: Array
    azimuth: float
    elevation: float
    size: tuple[int, int]
    margin: float = 0.08
    floor: float = 0.0
    axes: Array = field(init=False)
    scale: float = field(init=False)
    middle: Array = field(init=False)

    def __post_init__(self) -> None:
        azimuth, elevation = np.radians((self.azimuth, self.elevation))
        back = np.array(
            [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
        )
        right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        self.axes = np.array([right, np.cross(back, right), back])
        seen = self.around @ self.axes.T
        low, high = seen.min(axis=0), seen.max(axis=0)
        room = np.array(self.size) * OVERSAMPLED * (1.0 - 2.0 * self.margin)
        self.scale = float((room / (high - low)[:2]).min())
        self.middle = 0.5 * (low + high)

    def pixels(self, points: Array) -> Array:
        """Columns, rows and depths (towards the camera, in pixels) of points in [m], shape (k, 3)."""
        seen = (points @ self.axes.T - self.middle) * self.scale
        width, height = np.array(self.size) * OVERSAMPLED
        return np.column_stack([width / 2.0 + seen[:, 0], height / 2.0 - seen[:, 1], seen[:, 2]])


def neighbours(points: Array, triangles: IndexArray) -> csr_matrix:
    """Which faces lend each corner of each face their normals: those around its vertex that hardly turn."""
    normals = _face_normals(points, triangles)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    _, same = np.unique(np.round(points, 7), axis=0, return_inverse=True)
    vertex = same.reshape(-1)[triangles].ravel()
    face = np.repeat(np.arange(len(triangles)), 3)
    corner = np.arange(len(vertex))
    around = csr_matrix((np.ones(len(vertex)), (vertex, face)), shape=(vertex.max() + 1, len(triangles)))
    pairs = around[vertex].tocoo()
    alike = np.einsum("ij,ij->i", normals[pairs.col], normals[face[pairs.row]]) > CREASE
    return csr_matrix(
        (np.ones(alike.sum()), (pairs.row[alike], pairs.col[alike])), shape=(len(corner), len(triangles))
    )


def render(surfaces: Iterable[Surface], camera: Camera) -> Image.Image:
    """A picture of surfaces above a floor."""
    surfaces = list(surfaces)
    width, height = (OVERSAMPLED * side for side in camera.size)
    share = np.linspace(0.0, 1.0, height)[:, None, None]
    picture = np.broadcast_to(TOP + (BOTTOM - TOP) * share, (height, width, 3)).copy()
    picture *= 1.0 - (1.0 - SHADOW / SHADOW.max()) * 0.0
    dark = _shadow(surfaces, camera)[:, :, None]
    picture *= 1.0 - 0.55 * dark * (1.0 - SHADOW)
    front = np.full((height, width), -1e30)
    for surface in sorted(surfaces, key=lambda each: each.depth):  # opaque ones first
        _draw(surface, camera, picture, front)
    shown = Image.fromarray((255.0 * np.clip(picture, 0.0, 1.0)).astype(np.uint8))
    return shown.resize(camera.size, Image.Resampling.LANCZOS)


def tube(points: Array, radius: float, sides: int = 8) -> tuple[Array, IndexArray]:
    """A tube along a line of points in [m], shape (k, 3): vertices and triangles."""
    along = np.gradient(points, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    across = np.cross(along, [0.31, 0.17, 0.94])
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    other = np.cross(along, across)
    turn = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)
    ring = np.cos(turn)[:, None, None] * across + np.sin(turn)[:, None, None] * other
    vertices = (points + radius * ring).transpose(1, 0, 2).reshape(-1, 3)
    first = (np.arange(len(points) - 1)[:, None] * sides + np.arange(sides)).ravel()
    after = (np.arange(len(points) - 1)[:, None] * sides + (np.arange(sides) + 1) % sides).ravel()
    triangles = np.concatenate(
        [
            np.column_stack([first, after, after + sides]),
            np.column_stack([first, after + sides, first + sides]),
        ]
    )
    return vertices, triangles


def _face_normals(points: Array, triangles: IndexArray) -> Array:
    corners = points[triangles]
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _shadow(surfaces: list[Surface], camera: Camera) -> Array:
    """How much of the sun is kept from each pixel's place on the floor, in [0, 1]."""
    width, height = (OVERSAMPLED * side for side in camera.size)
    mask = np.zeros((height, width), np.uint8)
    for surface in surfaces:
        up = surface.points[:, 2] - camera.floor
        floor = surface.points - np.maximum(up, 0.0)[:, None] / SUN[2] * SUN
        _cover(camera.pixels(floor)[surface.triangles], mask)
    soft = Image.fromarray(mask).filter(ImageFilter.GaussianBlur(7.0 * OVERSAMPLED))
    return np.asarray(soft, dtype=float) / 255.0


def _draw(surface: Surface, camera: Camera, picture: Array, front: Array) -> None:
    """One surface onto the picture, where nothing nearer stands."""
    faces = _face_normals(surface.points, surface.triangles)
    if surface.smooth is None:
        normals = np.repeat(faces, 3, axis=0)
    else:
        normals = surface.smooth @ faces
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    normals = normals.reshape(-1, 3, 3)
    height, width = front.shape
    depth = np.full((height, width), -1e30)
    thick = np.zeros((height, width))
    seen = np.zeros((height, width, 3))
    _rasterise(camera.pixels(surface.points)[surface.triangles], normals, depth, thick, seen)
    there = depth > front
    normal = seen[there]
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    eye = camera.axes[2]
    facing = np.abs(normal @ eye)
    wrap = 0.35 if surface.depth else 0.1
    sun = np.clip((normal @ SUN + wrap) / (1.0 + wrap), 0.0, 1.0)[:, None]
    sky = (0.5 + 0.5 * normal[:, 2:]) * SKY + (0.5 - 0.5 * normal[:, 2:]) * GROUND
    half = (SUN + eye) / np.linalg.norm(SUN + eye)
    shine = surface.gloss * np.clip(normal @ half, 0.0, 1.0)[:, None] ** 48
    edge = 0.22 * (1.0 - facing)[:, None] ** 3
    colour = np.asarray(surface.colour)
    opaque = np.ones((len(normal), 1))
    if surface.depth:
        path = np.maximum(thick[there], 0.0)[:, None] / camera.scale
        opaque = 1.0 - 0.85 * np.exp(-path / surface.depth)
        colour = colour + (1.0 - colour) * 0.45 * np.exp(-path / (2.0 * surface.depth))
    lit = colour * (0.50 * sky + 0.62 * sun) + shine + edge
    picture[there] = opaque * lit + (1.0 - opaque) * picture[there] * (0.35 + 0.65 * colour)
    front[there] = depth[there]


@njit(cache=True)
def _rasterise(corners: Array, normals: Array, depth: Array, thick: Array, seen: Array) -> None:
    """Nearest depth, thickness along the ray and normal of each pixel that triangles cover."""
    height, width = depth.shape
    for k in range(len(corners)):
        x0, y0, z0 = corners[k, 0]
        x1, y1, z1 = corners[k, 1]
        x2, y2, z2 = corners[k, 2]
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if area == 0.0:
            continue
        towards = 1.0 if area < 0.0 else -1.0  # rows run downwards
        for row in range(max(0, int(min(y0, y1, y2))), min(height, int(max(y0, y1, y2)) + 2)):
            for column in range(max(0, int(min(x0, x1, x2))), min(width, int(max(x0, x1, x2)) + 2)):
                x, y = column + 0.5, row + 0.5
                a = ((x1 - x) * (y2 - y) - (x2 - x) * (y1 - y)) / area
                b = ((x2 - x) * (y0 - y) - (x0 - x) * (y2 - y)) / area
                c = 1.0 - a - b
                if a < 0.0 or b < 0.0 or c < 0.0:
                    continue
                z = a * z0 + b * z1 + c * z2
                thick[row, column] += towards * z
                if towards > 0.0 and z > depth[row, column]:
                    depth[row, column] = z
                    for i in range(3):
                        seen[row, column, i] = (
                            a * normals[k, 0, i] + b * normals[k, 1, i] + c * normals[k, 2, i]
                        )


@njit(cache=True)
def _cover(corners: Array, mask: Array) -> None:
    """Set the pixels that triangles cover."""
    height, width = mask.shape
    for k in range(len(corners)):
        x0, y0 = corners[k, 0, 0], corners[k, 0, 1]
        x1, y1 = corners[k, 1, 0], corners[k, 1, 1]
        x2, y2 = corners[k, 2, 0], corners[k, 2, 1]
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if area == 0.0:
            continue
        for row in range(max(0, int(min(y0, y1, y2))), min(height, int(max(y0, y1, y2)) + 2)):
            for column in range(max(0, int(min(x0, x1, x2))), min(width, int(max(x0, x1, x2)) + 2)):
                x, y = column + 0.5, row + 0.5
                a = ((x1 - x) * (y2 - y) - (x2 - x) * (y1 - y)) / area
                b = ((x2 - x) * (y0 - y) - (x0 - x) * (y2 - y)) / area
                if a >= 0.0 and b >= 0.0 and a + b <= 1.0:
                    mask[row, column] = 255
