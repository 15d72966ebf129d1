"""Faces of the packages: the names that the `__init__.pyi` of each gives to others."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

from source_trees import tree_of

REPOSITORY = Path(__file__).resolve().parents[1]
PACKAGES = ("softsim_core", "softsim_node", "softsim_ros", "servo_bridge", "benchmarks")


@cache
def packages() -> frozenset[str]:
    """Dotted names of the packages of the product."""
    inits = (file for top in PACKAGES for file in (REPOSITORY / top).rglob("__init__.py"))
    return frozenset(".".join(file.relative_to(REPOSITORY).parent.parts) for file in inits)


@cache
def modules(package: str) -> frozenset[str]:
    """Names of the modules in the folder of a package."""
    return frozenset(file.stem for file in REPOSITORY.joinpath(*package.split(".")).glob("*.py")) - {
        "__init__"
    }


@cache
def face(package: str) -> dict[str, str]:
    """Where each public name of a package comes from: a module or a package; "" for a module given whole."""
    stub = REPOSITORY.joinpath(*package.split("."), "__init__.pyi")
    found = {}
    for node in tree_of(stub).body if stub.is_file() else ():
        if isinstance(node, ast.ImportFrom) and node.level:
            found.update(
                {each.name: f"{package}.{node.module}" if node.module else "" for each in node.names}
            )
    return found


def home(package: str, name: str) -> str:
    """The module that defines a name of a package's face; or the package where the face has none."""
    while package in packages() and name in face(package):
        package = face(package)[name] or f"{package}.{name}"
    return package
