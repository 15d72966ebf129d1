"""Finite elements: materials, corotational tetrahedra, stress."""
