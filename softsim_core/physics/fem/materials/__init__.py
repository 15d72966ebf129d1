"""Material laws: one file each; register your own with `register_material`."""

from softsim_core.physics.fem.materials.material import Material, MaterialParameter
from softsim_core.physics.fem.materials.registry import material, material_names, register_material

__all__ = ["Material", "MaterialParameter", "material", "material_names", "register_material"]
