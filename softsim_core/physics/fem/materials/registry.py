"""Registry of material laws by name."""

from __future__ import annotations

from softsim_core.base import Registry
from softsim_core.physics.fem.materials.corotational import Corotational
from softsim_core.physics.fem.materials.corotational_qr import CorotationalQr
from softsim_core.physics.fem.materials.law import Material
from softsim_core.physics.fem.materials.mooney_rivlin import MooneyRivlin
from softsim_core.physics.fem.materials.ogden import Ogden
from softsim_core.physics.fem.materials.saint_venant_kirchhoff import SaintVenantKirchhoff
from softsim_core.physics.fem.materials.section import SECTION
from softsim_core.physics.fem.materials.stable_neo_hookean import StableNeoHookean
from softsim_core.physics.fem.materials.yeoh import Yeoh

_MATERIALS: Registry[Material] = Registry(
    "material law",
    Corotational(),
    CorotationalQr(),
    StableNeoHookean(),
    Yeoh(),
    Ogden(),
    MooneyRivlin(),
    SaintVenantKirchhoff(),
    SECTION,
)


def register_material(law: Material) -> None:
    """Make a law known to scenes by its name.

    Raises:
        SceneError: the name is one of the package's own.
    """
    _MATERIALS.register(law)


def material(name: str) -> Material:
    """Return the law of that name.

    Raises:
        SceneError: there is none; the message lists the known ones.
    """
    return _MATERIALS.get(name)


def material_names() -> tuple[str, ...]:
    """Return the names of all known laws."""
    return _MATERIALS.names()
