"""Robots, parts, materials: `scenes`, `new`, `mesh`, `material`, `mjcf`, `urdf`, `workspace`."""
