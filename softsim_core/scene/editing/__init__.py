"""Editing a scene's file: typed edits that keep its comments, undo and redo, and what regions choose."""

from softsim_core.scene.editing.document import SceneDocument
from softsim_core.scene.editing.edits import Edit, Put, Remove

__all__ = ["Edit", "Put", "Remove", "SceneDocument"]
