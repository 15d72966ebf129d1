"""Interface packages that PyPI lacks, made for a test by the generators of the ROS wheels and gcc.

The definitions lie in tests/interfaces/PACKAGE/{msg,srv,action}: names and types of the public interfaces,
each with the release that it follows. Where the package itself is installed (apt's ROS 2), that is used.
"""

from __future__ import annotations

import fcntl
import hashlib
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

DEFINITIONS = Path(__file__).parent / "interfaces"
PREFIX = Path(sys.prefix)
MADE = Path(__file__).resolve().parents[1] / ".softsim" / "interfaces"
"""Where packages stay once they are made; their libraries hold the places of others, and cannot be moved."""

GENERATORS = (
    "rosidl_adapter",
    "rosidl_generator_c",
    "rosidl_generator_py",
    "rosidl_generator_type_description",
    "rosidl_typesupport_c",
    "rosidl_typesupport_fastrtps_c",
    "rosidl_typesupport_introspection_c",
)
USED = (
    *("action_msgs", "builtin_interfaces", "geometry_msgs", "service_msgs", "std_msgs"),
    *("trajectory_msgs", "unique_identifier_msgs"),
)
"""Packages whose messages the definitions contain, and those that every service and action contains."""

SUPPORTS = ("rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c")


def why_missing(name: str) -> str:
    """Why the package is neither here nor can be made; empty where it is, or can."""
    if importlib.util.find_spec(name) is not None:
        return ""
    missing = [each for each in ("gcc", "g++") if shutil.which(each) is None]
    missing += [each for each in GENERATORS if importlib.util.find_spec(each) is None]
    return f"{name} is not installed and cannot be made: no {', '.join(missing)}" if missing else ""


@contextmanager
def interface_package(name: str) -> Iterator[None]:
    """The package can be imported, in new processes, too; skips where none can be made."""
    if importlib.util.find_spec(name) is not None:
        yield
        return
    if missing := why_missing(name):
        pytest.skip(missing)
    with pytest.MonkeyPatch.context() as patch:
        place = str(made(name) / "python")
        patch.syspath_prepend(place)
        patch.setenv("PYTHONPATH", os.pathsep.join(filter(None, [place, os.environ.get("PYTHONPATH")])))
        yield
        for module in [each for each in sys.modules if each.partition(".")[0] == name]:
            del sys.modules[module]


def made(name: str) -> Path:
    """The folder of a package that was made here once, by whichever test came first."""
    content = [file.read_bytes() for file in (Path(__file__), *sorted((DEFINITIONS / name).glob("*/*")))]
    wheels = sorted(each.name for each in Path(sysconfig.get_paths()["purelib"]).glob("ros*.dist-info"))
    digest = hashlib.sha256(b"\0".join([*content, *map(str.encode, [sys.version, str(PREFIX), *wheels])]))
    folder = MADE / f"{name}-{digest.hexdigest()[:16]}"
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # another worker may need it now, too
        if not (folder / "whole").exists():
            for part in folder.iterdir():
                if part.is_dir():  # of a run that was ended meanwhile
                    shutil.rmtree(part)
            package = Package(name, folder)
            package.generate()
            package.compile()
            (folder / "whole").touch()
    return folder


class Package:
    """A package on its way from definitions to Python.

    Args:
        name: Its name, a folder in DEFINITIONS.
        folder: One without folders for everything that is made.
    """

    def __init__(self, name: str, folder: Path) -> None:
        self.name, self._folder = name, folder
        self._share, self._include = folder / "share" / name, folder / "include" / name
        self._introspection, self._python = folder / "introspection" / name, folder / "python" / name

    def generate(self) -> None:
        """Write the sources."""
        self._folder.mkdir(parents=True, exist_ok=True)
        import rosidl_typesupport_c
        import rosidl_typesupport_fastrtps_c
        import rosidl_typesupport_introspection_c
        from rosidl_adapter import convert_to_idl
        from rosidl_generator_c import generate_c
        from rosidl_generator_py.generate_py_impl import generate_py
        from rosidl_generator_type_description import generate_type_hash

        source = DEFINITIONS / self.name
        files = [file.relative_to(source) for file in sorted(source.glob("*/*"))]
        for file in files:
            convert_to_idl(source, self.name, file, self._share)
        idl = [file.with_suffix(".idl") for file in files]
        known = [each for each in (PREFIX / "share").iterdir() if any(each.glob("*/*.idl"))]
        common = {
            "package_name": self.name,
            "idl_tuples": [f"{self._share}:{file}" for file in idl],
            "ros_interface_files": [str(source / file) for file in files],
            "target_dependencies": [],
            "include_paths": [f"{each.name}:{each}" for each in known],
            "type_description_tuples": [f"{file}:{self._share / file.with_suffix('.json')}" for file in idl],
        }

        def arguments(generator: str, output: Path) -> str:
            output.mkdir(parents=True, exist_ok=True)
            templates = PREFIX / "share" / generator / "resource"
            text = json.dumps({**common, "output_dir": str(output), "template_dir": str(templates)})
            file = self._folder / f"{self.name}_{generator}.json"
            file.write_text(text)
            return str(file)

        generate_type_hash(arguments("rosidl_generator_type_description", self._share))
        generate_c(arguments("rosidl_generator_c", self._include))
        fast, introspection = SUPPORTS
        rosidl_typesupport_fastrtps_c.generate_typesupport_fastrtps_c(arguments(fast, self._include))
        rosidl_typesupport_introspection_c.generate_c(arguments(introspection, self._introspection))
        rosidl_typesupport_c.generate_c(arguments("rosidl_typesupport_c", self._include), list(SUPPORTS))
        generate_py(arguments("rosidl_generator_py", self._python), ["rosidl_typesupport_c"])
        for part in ("rosidl_generator_c", *SUPPORTS):
            self._write_visibility(part)
        preloaded = [str(self._library(part)) for part in ("rosidl_generator_c", *reversed(SUPPORTS))]
        (self._python / "__init__.py").write_text(
            f"import ctypes\n\nfor library in {preloaded!r}:\n    ctypes.CDLL(library)\n"
        )

    def _write_visibility(self, part: str) -> None:
        (self._include / "msg").mkdir(parents=True, exist_ok=True)
        header = f"{part}__visibility_control.h"
        text = (PREFIX / "share" / part / "resource" / f"{header}.in").read_text()
        text = text.replace("@PROJECT_NAME_UPPER@", self.name.upper()).replace("@PROJECT_NAME@", self.name)
        (self._include / "msg" / header).write_text(text)

    def compile(self) -> None:
        """Make its libraries, those side by side that do not need each other."""
        (self._folder / "lib").mkdir()
        fast, introspection = SUPPORTS
        functions = [
            each for end in ("functions", "description", "type_support") for each in self._details(f"{end}.c")
        ]
        self._run(self._make("rosidl_generator_c", functions, ()))
        runtimes = ("-lrosidl_typesupport_fastrtps_c", "-lrosidl_typesupport_fastrtps_cpp", "-lfastcdr")
        self._run(
            self._make(fast, self._details("type_support_c.cpp"), runtimes),
            self._make(
                introspection,
                self._introspection.glob("*/detail/*__type_support.c"),
                ("-lrosidl_typesupport_introspection_c",),
            ),
            self._make(
                "rosidl_typesupport_c",
                self._include.glob("*/*__type_support.cpp"),
                ("-lrosidl_typesupport_c",),
            ),
            self._make("rosidl_generator_py", self._python.glob("*/_*_s.c"), ()),
        )
        suffix = sysconfig.get_config_var("EXT_SUFFIX")
        extension = self._python / f"{self.name}_s__rosidl_typesupport_c{suffix}"
        own = [f"-l{self.name}__{part}" for part in ("rosidl_generator_py", "rosidl_typesupport_c")]
        sources = self._python.glob("_*_s.ep.rosidl_typesupport_c.c")
        self._run(self._command(extension, sources, (*own, "-lrosidl_typesupport_c")))

    def _details(self, end: str) -> list[Path]:
        return sorted(self._include.glob(f"*/detail/*__{end}"))

    def _library(self, part: str) -> Path:
        return self._folder / "lib" / f"lib{self.name}__{part}.so"

    def _make(self, part: str, sources: Iterable[Path], links: Iterable[str]) -> list[str]:
        """The command that makes one of the package's libraries."""
        return self._command(self._library(part), sources, (*links, *self._links_of_used(part)))

    def _links_of_used(self, part: str) -> list[str]:
        parts = dict.fromkeys((part, "rosidl_generator_c"))
        return [
            f"-l{use}__{each}"
            for each in parts
            for use in USED
            if (PREFIX / "lib" / f"lib{use}__{each}.so").exists()
        ]

    def _command(self, target: Path, sources: Iterable[Path], links: Iterable[str]) -> list[str]:
        import numpy

        files = sorted(map(str, sources))
        folders = [
            *(self._folder / "include", self._folder / "introspection", PREFIX / "include"),
            *(each for each in (PREFIX / "include").iterdir() if each.is_dir()),
            *(sysconfig.get_paths()["include"], numpy.get_include()),
        ]
        own = self._library("rosidl_generator_c")
        libraries = [PREFIX / "lib", own.parent]
        return [
            *("g++" if files[0].endswith("cpp") else "gcc", "-O0", "-fPIC", "-shared", "-w", *files),
            *("-o", str(target), f"-Wl,-soname,{target.name}"),
            *(f"-I{each}" for each in folders),
            *(f"-L{each}" for each in libraries),
            *(f"-Wl,-rpath,{each}" for each in libraries),
            *links,
            *([] if target == own else [f"-l{self.name}__rosidl_generator_c"]),
            *("-lrosidl_runtime_c", "-lrcutils"),
        ]

    def _run(self, *commands: list[str]) -> None:
        """Run commands side by side."""
        running: list[Any] = [
            subprocess.Popen(each, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
            for each in commands
        ]
        said = [each.communicate()[0] for each in running]
        assert not any(each.returncode for each in running), "\n".join(said)
