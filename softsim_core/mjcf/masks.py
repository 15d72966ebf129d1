"""Which bodies of a scene may touch, as MuJoCo's masks of bits."""

from __future__ import annotations

from dataclasses import dataclass

from softsim_core.mjcf.reading import Told
from softsim_core.scene.description import SceneDescription

_BITS = 31


@dataclass(frozen=True, slots=True)
class Mask:
    """MuJoCo's contype and conaffinity."""

    own: int = 0
    others: int = 0


def masks(scene: SceneDescription, told: Told) -> dict[str, Mask]:
    """A bit for each body with collision surfaces, and the bits of those it meets."""
    groups: dict[str, list[frozenset[str]]] = {name: [] for name in scene.body_names}
    for collision in scene.collisions:
        groups[collision.body].append(frozenset(collision.groups))
        if collision.surface is not None or collision.boxes or collision.faces is not None:
            told.say(f"collision {collision.name}", "the whole surface of its body touches in the model")
    touching = [name for name, each in groups.items() if each]
    if len(touching) > _BITS:
        told.say(
            "collisions",
            f"all of the {len(touching)} bodies with a surface may touch each other in the model",
        )
        return {name: Mask(int(bool(each)), int(bool(each))) for name, each in groups.items()}
    bit = {name: 1 << k for k, name in enumerate(touching)}
    return {
        name: Mask(
            bit.get(name, 0),
            sum(bit[other] for other in touching if other != name and _meet(each, groups[other])),
        )
        for name, each in groups.items()
    }


def _meet(ours: list[frozenset[str]], theirs: list[frozenset[str]]) -> bool:
    return any(not a & b for a in ours for b in theirs)
