"""Faces: what a package gives to others stands in its `__init__.pyi`, and others use nothing else of it."""

from __future__ import annotations

import ast
import os
import random
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from faces import REPOSITORY, face, home, modules, packages
from source_trees import tree_of

PRODUCT = ("softsim_core", "softsim_node", "softsim_ros", "servo_bridge", "benchmarks")
IMPORT = re.compile(rf"from ((?:{'|'.join(PRODUCT)})(?:\.\w+)*) import (\([^()]*\)|[\w ,]+)")
MOST_FILES_OF_A_MOVE = 3


@cache
def sources() -> tuple[Path, ...]:
    """Python files and pages of the repository, links left out."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.py", "*.md", "*.ipynb"]
    listed = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False).stdout
    files = (REPOSITORY / name for name in listed.splitlines())
    return tuple(file for file in files if file.is_file() and not file.is_symlink())


@pytest.fixture(scope="module", autouse=True)
def in_a_checkout() -> None:
    if not sources():
        pytest.skip("not a checkout of git")


def owner(file: Path) -> str:
    """The package that a file lies in."""
    return ".".join(file.relative_to(REPOSITORY).parent.parts)


def imports(file: Path) -> Iterator[tuple[str, str, int]]:
    """Each name that a file imports from the product: package or module, name, line."""
    if file.suffix != ".py":
        for found in IMPORT.finditer(file.read_text(encoding="utf-8")):
            for name in re.findall(r"(\w+)(?: as \w+)?", found[2].strip("()")):
                yield found[1], name, 0
        return
    for node in ast.walk(tree_of(file)):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] in PRODUCT:
            yield from ((node.module, each.name, node.lineno) for each in node.names)


def test_imports_across_packages_use_faces() -> None:
    deep = [
        f"{file.relative_to(REPOSITORY)}:{line} imports {name} of {module}"
        for file in sources()
        for module, name, line in imports(file)
        if module not in packages() and module.rpartition(".")[0] != owner(file)
    ]
    assert deep == []


def test_the_product_imports_no_module_that_a_face_does_not_give() -> None:
    """Tests may: what they replace in a module is its own."""
    found = [
        f"{file.relative_to(REPOSITORY)}:{line} imports {module}.{name}"
        for file in sources()
        if file.relative_to(REPOSITORY).parts[0] in (*PRODUCT, "examples", "configs")
        for module, name, line in imports(file)
        if module in packages() and module != owner(file) and name in modules(module) - face(module).keys()
    ]
    assert found == []


def defined(file: Path) -> set[str]:
    """Names that a module defines at its top level."""
    found: set[str] = set()
    for node in ast.walk(tree_of(file)):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found.add(node.id)
    return found


def test_a_face_gives_what_there_is() -> None:
    for package in sorted(packages()):
        for name, module in face(package).items():
            if not module:
                assert name in modules(package), f"{package} has no module {name}"
            elif module in packages():
                assert name in face(module), f"{package}: {module} does not give {name}"
            else:
                file = REPOSITORY.joinpath(*module.split(".")).with_suffix(".py")
                assert name in defined(file), f"{package}: {name} is not defined in {module}"


def test_no_name_of_a_face_is_a_module_beside_it() -> None:
    """`from package import name` would give one or the other, depending on what was loaded before."""
    for package in sorted(packages()):
        below = {name.rpartition(".")[2] for name in packages() if name.rpartition(".")[0] == package}
        names = {name for name, module in face(package).items() if module}
        assert names & (modules(package) | below) == set(), package


def uses(file: Path) -> Iterator[tuple[str, str]]:
    """Names of other packages that a file imports, or reads of a package that it imports whole."""
    found = [(module, name) for module, name, _ in imports(file) if module != owner(file)]
    yield from found
    for module, name in found:
        if f"{module}.{name}" in packages():
            text = file.read_text(encoding="utf-8")
            yield from ((f"{module}.{name}", each) for each in re.findall(rf"\b{name}\.(\w+)", text))


def test_every_name_of_a_face_is_used_elsewhere() -> None:
    used = {each for file in sources() for each in uses(file)}
    library = {(home("softsim_core", name), name) for name in face("softsim_core")}
    idle = [
        f"{package}: {name}"
        for package in sorted(packages() - {"softsim_core"})
        for name in face(package)
        if (package, name) not in used and (home(package, name), name) not in library
    ]
    assert idle == []


def public_classes() -> list[tuple[str, str]]:
    """Module and name of each class that a face gives."""
    found = {
        (home(package, name), name) for package in packages() for name in face(package) if name[:1].isupper()
    }
    return sorted(
        (module, name)
        for module, name in found
        if module not in packages()
        for node in tree_of(REPOSITORY.joinpath(*module.split(".")).with_suffix(".py")).body
        if isinstance(node, ast.ClassDef) and node.name == name
    )


@cache
def naming(file: Path) -> frozenset[str]:
    """Modules that a file names, dotted or as paths."""
    text = file.read_text(encoding="utf-8")
    dotted = re.findall(rf"\b(?:{'|'.join(PRODUCT)})(?:\.\w+)+", text)
    paths = re.findall(rf"\b((?:{'|'.join(PRODUCT)})(?:/\w+)+)\.py\b", text)
    return frozenset(
        {*dotted, *(name.rpartition(".")[0] for name in dotted), *(p.replace("/", ".") for p in paths)}
    )


def test_a_class_that_moves_within_its_package_touches_few_files_elsewhere() -> None:
    """What names a class by its module: imports, dotted names in texts, and links beside its name."""
    classes = public_classes()
    assert len(classes) > 300
    for module, name in classes:
        package = module.rpartition(".")[0]
        path = module.replace(".", "/") + ".py"
        named = re.compile(
            rf"\b{re.escape(module)}(\.{name}\b| import [^\n]*\b{name}\b)"
            rf"|\b{name}\b[^\n]*{re.escape(path)}|{re.escape(path)}[^\n]*\b{name}\b"
        )
        candidates = (file for file in sources() if module in naming(file) and owner(file) != package)
        elsewhere = [file for file in candidates if named.search(file.read_text(encoding="utf-8"))]
        assert len(elsewhere) <= MOST_FILES_OF_A_MOVE, f"{module}.{name}: {elsewhere}"


MOVED = 20
LOADED = """
import importlib, sys
for line in sys.stdin:
    words = line.split()
    try:
        module = importlib.import_module(words[0])
    except ModuleNotFoundError as error:  # of an extra
        assert not error.name.startswith(("softsim", "servo_bridge")), (words, error)
    if len(words) == 3:
        assert getattr(module, words[1]).__module__ == words[2], words
"""
"""Reads lines of modules, and of packages with a class and the module from which they give it."""


@pytest.mark.slow
def test_classes_that_really_move_are_found_by_all_that_use_them(tmp_path: Path) -> None:
    """In a copy, the files of twenty classes get other names, and their own packages follow."""
    for name in PRODUCT:
        shutil.copytree(REPOSITORY / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    classes = public_classes()
    drawn = random.Random(20).sample(sorted({module for module, _ in classes}), MOVED)
    touched: dict[str, list[Path]] = {module: [] for module in drawn}
    for module in drawn:
        package, _, stem = module.rpartition(".")
        folder = tmp_path.joinpath(*package.split("."))
        (folder / f"{stem}.py").rename(folder / f"{stem}_elsewhere.py")
        for above in (folder, *folder.relative_to(tmp_path).parents):  # its own face, and outer ones
            if (stub := tmp_path / above / "__init__.pyi").is_file():
                inner = module.removeprefix(".".join(stub.parent.relative_to(tmp_path).parts) + ".")
                moved = stub.read_text().replace(f"from .{inner} import", f"from .{inner}_elsewhere import")
                stub.write_text(moved)
        for file in tmp_path.rglob("*.py"):
            text = file.read_text(encoding="utf-8")
            if (changed := re.sub(rf"\b{re.escape(module)}\b", f"{module}_elsewhere", text)) != text:
                file.write_text(changed, encoding="utf-8")
                touched[module] += [file] if file.parent != folder else []
    assert {module: files for module, files in touched.items() if len(files) > MOST_FILES_OF_A_MOVE} == {}

    def now(module: str) -> str:
        return f"{module}_elsewhere" if module in drawn else module

    given = [
        f"{package} {name} {now(home(package, name))}"
        for package in sorted(packages())
        for name in face(package)
        if (home(package, name), name) in classes
    ]
    every = [now(f"{package}.{name}") for package in sorted(packages()) for name in sorted(modules(package))]
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", LOADED],
        input="\n".join([*given, *every]),
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


LEAST_LINES = 80
ALONE = {
    "softsim_core.base.program_starter": "runs a program of ours in another process",
    "softsim_core.mjcf.probe": "runs in a process that a broken model may end",
    "softsim_core.robots.tentacle_mesh": "a generator, run as a program",
    "softsim_core.simulation.batch.worker": "runs in the processes of a batch",
    **{f"{package}.executables": "entry points of ros2 run" for package in ("servo_bridge", "softsim_ros")},
}
"""Small modules with at most one importer that are neither a law nor a command, and why they are modules."""


def test_no_small_module_stands_alone() -> None:
    """A file with one importer belongs into that file, but for extension points, commands and programs."""
    importers: dict[str, set[Path]] = {}
    for file in sources():
        if file.relative_to(REPOSITORY).parts[0] in PRODUCT and file.suffix == ".py":
            for module, name, _ in imports(file):
                found = home(module, name)
                importers.setdefault(f"{found}.{name}" if found in packages() else found, set()).add(file)
    alone = set()
    for package in packages():
        for name in modules(package):
            lines = (
                REPOSITORY.joinpath(*package.split("."), f"{name}.py").read_text(encoding="utf-8").count("\n")
            )
            if lines < LEAST_LINES and len(importers.get(f"{package}.{name}", ())) < 2:
                alone.add(f"{package}.{name}")
    extension_points = ("softsim_core.physics.fem.materials.", "softsim_ros.cli.")
    assert {name for name in alone if not name.startswith(extension_points)} == set(ALONE)
