"""Editing a scene's file: typed edits that keep its comments, undo and redo, and what regions choose."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
