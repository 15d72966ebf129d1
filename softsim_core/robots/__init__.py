"""Robots by parameters, and the generators of their meshes; nothing below knows a robot."""
