"""Compiled cells: their forces and stiffness in vector code, by element and law."""
