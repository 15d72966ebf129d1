"""Material laws: one file each; register your own with `register_material`."""

from softsim_core.fem.materials.material import Material, MaterialParameter
from softsim_core.fem.materials.registry import material, material_names, register_material

__all__ = ["Material", "MaterialParameter", "material", "material_names", "register_material"]
