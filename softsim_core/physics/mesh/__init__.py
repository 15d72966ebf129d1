"""Meshes: types, readers, checks, surfaces, embedding, and generators of our own robots.

`softsim_core.robots.tripod_mesh` makes the Tripod's silicone; meshio is imported only when a file needs it.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
