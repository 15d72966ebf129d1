"""From the surface of a part, as CAD programs export it, to tetrahedra: `mesh_part`."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
