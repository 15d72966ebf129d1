"""Rigid robots from URDF files that carry soft ones: the key `arm` of a scene."""
