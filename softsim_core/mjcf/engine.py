"""Access to MuJoCo's own library: find it, silence it, and run a model."""

from __future__ import annotations

import importlib
import signal
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from softsim_core.base import Array, MjcfError, install_command, python_command, run_process
from softsim_core.mjcf.probe import REFUSED

INSTALL = f"{install_command('mujoco')} (MuJoCo 3.13 or newer)"
TIME_LIMIT_S = 120.0
"""Time limit in [s] of the first look at a model."""


def library(file: str | Path) -> Any:
    """Return the module `mujoco`, needed for `file`; disable its prints of warnings to stderr and a file.

    Raises:
        MjcfError: it is not installed, or is too old for implicit steps of flexes.
    """
    try:
        mujoco = importlib.import_module("mujoco")
    except ImportError as error:
        raise MjcfError(file, f"MuJoCo is not installed ({error}): {INSTALL}") from error
    if not hasattr(mujoco.mjtIntegrator, "mjINT_DISCRETE"):
        raise MjcfError(file, f"MuJoCo {mujoco_version()} has no integrator discrete: {INSTALL}")
    mujoco.set_mju_user_warning(lambda _: None)  # MujocoRun.warnings counts them
    return mujoco


def mujoco_version() -> str:
    """Return the version of the installed library, or an empty text."""
    for name in ("mujoco-core", "mujoco"):
        try:
            return version(name)
        except PackageNotFoundError:
            continue
    return ""


def look_at(file: Path, time_limit: float = TIME_LIMIT_S) -> None:
    """Let MuJoCo read a model in a separate process, within limits of time and memory.

    Raises:
        MjcfError: MuJoCo rejects it, crashes, or takes too long.
    """
    command = python_command(Path(__file__).with_name("probe.py"), file)
    try:
        streams: dict[str, Any] = {"stdin": subprocess.DEVNULL, "capture_output": True}
        done = run_process(command, text=True, errors="replace", timeout=time_limit, **streams)
    except subprocess.TimeoutExpired as error:
        raise MjcfError(file, f"MuJoCo was stopped after {time_limit:g} s; make the model smaller") from error
    if done.returncode == REFUSED:
        raise MjcfError(file, f"MuJoCo refuses it: {done.stdout.strip()}")
    by_signal = signal.Signals(-done.returncode).name if done.returncode < 0 else ""
    if by_signal in ("SIGXCPU", "SIGKILL"):
        raise MjcfError(file, "MuJoCo was stopped: it takes too much time or memory; make the model smaller")
    if by_signal:
        raise MjcfError(file, f"MuJoCo crashes on it ({by_signal}); look at its files")
    if done.returncode:
        last = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        raise MjcfError(file, f"MuJoCo fails on it ({last[:200]})")


class MujocoRun:
    """A model, a file or an MJCF document, that runs in MuJoCo as it specifies.

    Raises:
        MjcfError: MuJoCo is not installed, or rejects the model.

    Attributes:
        name: Name of the engine in comparisons.
        rests: Whether its bodies come to rest.
        method: How it computes a step.
    """

    name = "mujoco"
    rests = True

    def __init__(self, model: Path | str) -> None:
        name = model if isinstance(model, Path) else "the document"
        mujoco = library(name)
        load = mujoco.MjModel.from_xml_path if isinstance(model, Path) else mujoco.MjModel.from_xml_string
        try:
            self.model: Any = load(str(model))
        except ValueError as error:
            raise MjcfError(name, f"MuJoCo refuses it: {' '.join(str(error).split())[:300]}") from error
        self.data: Any = mujoco.MjData(self.model)
        self.version = mujoco_version()
        self._mujoco = mujoco
        self._step = mujoco.mj_step
        most = int(self.model.opt.iterations)
        self.method = f"Saint Venant-Kirchhoff, integrator {self.integrator}, at most {most} iterations"
        self.restart()

    @property
    def integrator(self) -> str:
        """MuJoCo's integrator."""
        kind = self._mujoco.mjtIntegrator(self.model.opt.integrator)
        return str(kind.name).removeprefix("mjINT_").lower()

    @property
    def dt(self) -> float:
        """Time step in [s]."""
        return float(self.model.opt.timestep)

    @property
    def warnings(self) -> int:
        """Number of MuJoCo's warnings since the start, such as one per step whose solve did not converge."""
        return int(self.data.warning.number.sum())

    def restart(self) -> None:
        """Return to the start, without velocity."""
        self._mujoco.mj_resetData(self.model, self.data)
        self._mujoco.mj_forward(self.model, self.data)

    def advance(self) -> None:
        """Advance by one dt."""
        self._step(self.model, self.data)

    def points(self) -> Array:
        """Return the present vertices of all flexes in [m], shape (n, 3)."""
        self._place()
        return np.array(self.data.flexvert_xpos)

    def bodies(self, names: tuple[str, ...]) -> Array:
        """Return the present centres of mass of bodies in [m], shape (k, 3)."""
        self._place()
        return np.array([self.data.body(name).xipos for name in names]).reshape(-1, 3)

    def _place(self) -> None:
        """Update all positions: a step advances only the coordinates."""
        self._mujoco.mj_kinematics(self.model, self.data)
        self._mujoco.mj_comPos(self.model, self.data)
        self._mujoco.mj_flex(self.model, self.data)
