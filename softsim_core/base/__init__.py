"""What every other package uses: errors, units, values, arrays, names, files, processes."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
