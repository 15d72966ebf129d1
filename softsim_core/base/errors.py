"""Typed errors of the suite with their data. A message says what is wrong, where, and what is allowed."""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike


def listing(names: Iterable[object]) -> str:
    """Return known names for a message: "servo_0, servo_1", or "none" for an empty collection."""
    return ", ".join(str(name) for name in names) or "none"


class SoftSimError(Exception):
    """Base class of all errors that the suite raises on purpose; its text is meant for a person.

    Names in the text may come from untrusted files. Escape sequences, and marks that change the direction of
    writing, are shown as text, so that no terminal interprets them.
    """

    def __str__(self) -> str:
        text = super().__str__()
        if text.isprintable():
            return text
        return "".join(each if each.isprintable() else repr(each)[1:-1] for each in text)


class ArrayError(SoftSimError, ValueError):
    """An array has the wrong shape or type; carries its name and the required shape."""

    def __init__(self, name: str, shape: tuple[int, ...], given: str) -> None:
        self.name, self.shape = name, shape
        lengths = ", ".join("any" if length < 0 else str(length) for length in shape)
        expected = f"({lengths},)" if len(shape) == 1 else f"({lengths})"
        super().__init__(f"{name} refused: expected real numbers of shape {expected}, not {given}")


class FactorisationError(SoftSimError, ArithmeticError):
    """A matrix could not be factorised: it is singular, or contains numbers that are not finite."""


class MeshError(SoftSimError, ValueError):
    """A mesh file or mesh array cannot be used; carries its source (file path or name) and the reason."""

    def __init__(self, source: str | PathLike[str], reason: str) -> None:
        self.source, self.reason = str(source), reason
        super().__init__(f"mesh {self.source}: {reason}")


class MaterialError(SoftSimError, ValueError):
    """A material parameter lies outside its interval; carries its name, value and allowed range."""

    def __init__(self, name: str, value: object, allowed: str) -> None:
        self.name, self.value, self.allowed = name, value, allowed
        super().__init__(f"material parameter {name} = {value} {allowed}")


class ConfigError(SoftSimError, ValueError):
    """A configuration file has a wrong key or value.

    Attributes:
        file: Path of the file.
        key: Path of the key in it, such as "bodies[0].density"; "": the whole file.
        problem: What is wrong and what is allowed.
        place: Line and column of the key, counted from 1; None: not known.
    """

    def __init__(
        self, file: str | PathLike[str], key: str, problem: str, place: tuple[int, int] | None = None
    ) -> None:
        self.file, self.key, self.problem, self.place = str(file), key, problem, place
        where = [
            self.file,
            *([f"line {place[0]}, column {place[1]}"] if place else ()),
            *([key] if key else ()),
        ]
        super().__init__(": ".join([*where, problem]))


class DataError(SoftSimError, ValueError):
    """Measured data cannot be used; carries their source (file or session), the place in it, the problem."""

    def __init__(self, source: str | PathLike[str], where: str, problem: str) -> None:
        self.source, self.where, self.problem = str(source), where, problem
        super().__init__(f"{self.source}: {where}: {problem}" if where else f"{self.source}: {problem}")


class StudyError(SoftSimError, RuntimeError):
    """A study cannot be run, continued or read; the message says why and what to do."""


class PolicyError(SoftSimError, ValueError):
    """A trained policy cannot be read, or does not fit; carries its file and the reason."""

    def __init__(self, file: str | PathLike[str], reason: str) -> None:
        self.file, self.reason = str(file), reason
        super().__init__(f"policy {self.file} refused: {reason}")


class MjcfError(SoftSimError, ValueError):
    """A MuJoCo model (MJCF) cannot be read, written or run; carries its file and the reason."""

    def __init__(self, file: str | PathLike[str], reason: str) -> None:
        self.file, self.reason = str(file), reason
        super().__init__(f"{self.file}: {reason}")


class SceneError(SoftSimError, ValueError):
    """A scene description is inconsistent (unknown name, empty region, overlapping regions)."""


class CommandError(SoftSimError, ValueError):
    """A joint command is refused as a whole; no part of it is applied."""


class SnapshotError(SoftSimError, ValueError):
    """Bytes given to restore are not a snapshot of this scene."""


class SolverDivergedError(SoftSimError, RuntimeError):
    """A step produced a non-finite or runaway state; the simulation returns to its last good one."""

    def __init__(self, step: int, time_s: float, worst_node: int) -> None:
        self.step, self.time_s, self.worst_node = step, time_s, worst_node
        super().__init__(
            f"diverged at step {step} (t = {time_s:.3f} s), node {worst_node}; reduce dt or the load per step"
        )


class DetectionOverflowError(SoftSimError, RuntimeError):
    """Contact detection found more feature pairs than it can list; carries their number and the limit."""

    def __init__(self, needed: int, most: int) -> None:
        self.needed, self.most = needed, most
        super().__init__(
            f"contact detection meets {needed} pairs of features that come close, of at most {most}: bodies "
            "move too far per step or are crushed into each other; reduce dt, the load or the alarm distance"
        )


class NotReachedError(SoftSimError, ValueError):
    """No joint positions bring a joint's frame to a place; carries joint, place in [m], least distance."""

    def __init__(self, joint: str, position: tuple[float, ...], miss: float) -> None:
        self.joint, self.position, self.miss = joint, position, miss
        super().__init__(
            f"the frame of {joint} does not reach {list(position)} m turned as asked: {1e3 * miss:.3g} mm "
            "are left within the limits; choose a nearer place or another start"
        )


class NotConvergedError(SoftSimError, RuntimeError):
    """No static equilibrium was found; carries the reason, the fraction of the load, iterations, residual."""

    def __init__(self, reason: str, fraction: float, iterations: int, residual: float) -> None:
        self.reason, self.fraction, self.iterations, self.residual = reason, fraction, iterations, residual
        super().__init__(
            f"no static equilibrium found: {reason} at {100.0 * fraction:.3g} % of the load, after "
            f"{iterations} iterations, residual {residual:.3g} N; start from a nearer state, change the "
            "load, or let the dynamics settle"
        )


class BatchError(SoftSimError, RuntimeError):
    """A batch of copies cannot be created, or one of its worker processes has ended."""
