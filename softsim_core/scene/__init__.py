"""Scenes: typed description, files, builder, ready-made parts."""
