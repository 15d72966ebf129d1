"""Former names of modules and of attributes of packages: they work for one release, with a warning.

Every program imports this first, so it imports little itself.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from importlib.machinery import ModuleSpec
    from types import CodeType, ModuleType


class FormerNames:
    """Import finder of modules by their former names, for `sys.meta_path`, from the new name by former name.

    A module of a package that has moved is found below its new name.
    """

    def __init__(self, modules: Mapping[str, str]) -> None:
        self._modules = dict(modules)

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Find a module that has moved; None for every other name."""
        new = self._new_name(fullname)
        if new is None:
            return None
        from importlib.machinery import ModuleSpec
        from importlib.util import find_spec

        found = find_spec(new)
        if found is None:
            return None
        loader: Any = _Moved(fullname, new)
        package = found.submodule_search_locations is not None
        return ModuleSpec(fullname, loader, origin=found.origin, is_package=package)

    def _new_name(self, old: str) -> str | None:
        """Return the new name of a module, or None if neither it nor a package around it has moved."""
        package, rest = old, ""
        while package:
            if package in self._modules:
                return self._modules[package] + rest
            package, dot, name = package.rpartition(".")
            rest = f"{dot}{name}{rest}"
        return None


class _Moved:
    """Loader of a module that has moved."""

    def __init__(self, old: str, new: str) -> None:
        self._old, self._new = old, new
        self._spec: ModuleSpec | None = None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """Return the module at its new place."""
        self._warn()
        module = import_module(self._new)
        self._spec = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Restore the specification that the import under the former name replaced; the module has run."""
        module.__spec__ = self._spec

    def get_code(self, fullname: str) -> CodeType | None:
        """Return the code that `python -m` runs."""
        from importlib.util import find_spec

        self._warn()
        loader: Any = getattr(find_spec(self._new), "loader", None)
        code: CodeType | None = loader.get_code(self._new)
        return code

    def _warn(self) -> None:
        message = f"{self._old} has moved: use {self._new}; release 0.3.0 removes the former name"
        warnings.warn(message, DeprecationWarning, stacklevel=3)  # 3: the importing module


class FormerAttribute:
    """Attribute of a class by its former name, until release 0.3.0; reading it warns."""

    def __init__(self, new: str) -> None:
        self._old, self._new = "", new

    def __set_name__(self, owner: type, name: str) -> None:
        self._old = name

    def __get__(self, instance: object, owner: type) -> Any:
        if instance is None:
            return self
        message = (
            f"{owner.__name__}.{self._old} is now {owner.__name__}.{self._new}; release 0.3.0 removes the "
            "former name"
        )
        warnings.warn(message, DeprecationWarning, stacklevel=2)
        return getattr(instance, self._new)


def keep_former_names(modules: Mapping[str, str]) -> None:
    """Let modules (new name by former name) also be imported by their former names, until release 0.3.0."""
    sys.meta_path.insert(0, FormerNames(modules))


def find_former_names(
    package: str, names: Mapping[str, str], find: Callable[[str], Any]
) -> Callable[[str], Any]:
    """Return a package's `__getattr__` that also finds attributes by their former names, until release 0.3.0.

    `names` gives the new name by former name; `find`, the package's `__getattr__`, knows the new ones.
    """

    def find_attribute(name: str) -> Any:
        new = names.get(name)
        if new is None:
            return find(name)
        message = f"{package}.{name} is now {package}.{new}; release 0.3.0 removes the former name"
        warnings.warn(message, DeprecationWarning, stacklevel=2)
        return find(new)

    return find_attribute
