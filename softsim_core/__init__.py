"""Soft-robot physics: finite elements, rigid frames, joints. NumPy arrays in and out."""
