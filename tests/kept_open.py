"""What is costly to start and is used by several test files in a row: it is started once."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from typing import Any

import pytest


class KeptOpen:
    """Contexts of fixtures that stay open as long as the next test uses their fixture, too.

    A fixture of the scope "module" takes its value from here. Unlike with the scope "session", the tests that
    follow run without it: it takes no processor time and no memory from them.
    """

    def __init__(self) -> None:
        self._open: dict[str, tuple[Any, ExitStack]] = {}

    def value(self, request: pytest.FixtureRequest, enter: Callable[[], AbstractContextManager[Any]]) -> Any:
        """Return the value of the fixture that asks; its context is entered where it is not open."""
        if not request.config.pluginmanager.is_registered(self):
            request.config.pluginmanager.register(self)
        name = str(request.fixturename)
        if name not in self._open:
            with ExitStack() as stack:
                value = stack.enter_context(enter())
                self._open[name] = value, stack.pop_all()
        return self._open[name][0]

    @pytest.hookimpl(trylast=True)
    def pytest_runtest_teardown(self, nextitem: pytest.Item | None) -> None:
        """Leave contexts that the next test does not use, the newest first."""
        needed = getattr(nextitem, "fixturenames", ())
        for name in reversed([name for name in self._open if name not in needed]):
            self._open.pop(name)[1].close()


kept_open = KeptOpen()
