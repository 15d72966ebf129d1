"""Description of a study: scene, variables, commands and measured quantities."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeAlias, cast, get_args

from softsim_core.base import ConfigError, FieldError, SceneError, listing, need_finite, need_positive
from softsim_core.lab.identification import (
    DistributionDescription,
    load_distribution,
    names_in,
)
from softsim_core.scene.io import (
    SourcedMapping,
    config_roots,
    given_values,
    laid_over,
    mark_source,
    read_extended,
    relative_to_file,
    structure_description,
)

Kind: TypeAlias = Literal["grid", "list", "random", "sobol", "latin_hypercube"]
Spacing: TypeAlias = Literal["linear", "log"]
At: TypeAlias = Literal["end", "max", "min", "mean", "series"]
Begin: TypeAlias = Literal["rest", "equilibrium"]

MOST_RUNS = 10_000_000
"""Largest number of runs of one study; larger studies must be split."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VariableDescription:
    """A number that differs from run to run; give its values, or two bounds.

    Attributes:
        name: Name in expressions.
        unit: Unit for display, and in the store.
        values: All its values; in a list, one for each run.
        lower, upper: Bounds, both included.
        count: Number of grid values between the bounds, ends included.
        spacing: Spacing of the values: even, or even in the logarithm.
    """

    name: str
    unit: str = ""
    values: tuple[float, ...] = ()
    lower: float | None = None
    upper: float | None = None
    count: int | None = None
    spacing: Spacing = "linear"

    def __post_init__(self) -> None:
        owner = f"variable {self.name}"
        need_word(owner, self.name)
        bounds = [each for each in (self.lower, self.upper) if each is not None]
        need_finite(owner, "values and bounds", (*self.values, *bounds))
        if bool(self.values) == bool(bounds) or len(bounds) == 1:
            raise SceneError(f"{owner}: give its values, or lower and upper")
        if len(bounds) == 2 and not bounds[0] < bounds[1]:
            raise FieldError(owner, "lower", bounds[0], f"less than upper, {bounds[1]:g}")
        if self.spacing not in get_args(Spacing):
            raise FieldError(owner, "spacing", repr(self.spacing), f"one of {listing(get_args(Spacing))}")
        if self.spacing == "log" and (not bounds or bounds[0] <= 0.0):
            raise FieldError(owner, "spacing", "log", "linear where there are no bounds > 0")
        if self.count is not None and (self.count < 2 or not bounds):
            raise FieldError(owner, "count", self.count, ">= 2, and only beside lower and upper")

    def between(self, share: float) -> float:
        """Return the value at a share in [0, 1] of the way from `lower` to `upper`."""
        assert self.lower is not None
        assert self.upper is not None
        if self.spacing == "log":
            return math.exp((1.0 - share) * math.log(self.lower) + share * math.log(self.upper))
        return (1.0 - share) * self.lower + share * self.upper


@dataclass(frozen=True, slots=True, kw_only=True)
class DesignDescription:
    """Design of the runs: combinations of the variables' values.

    Attributes:
        kind: "grid": every value with every other; "list": run k uses the k-th values; "random", "sobol" and
            "latin_hypercube": spread over the box of the bounds.
        samples: Number of runs of a spread design.
        seed: Seed of a spread design.
    """

    kind: Kind = "grid"
    samples: int | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if self.kind not in get_args(Kind):
            raise FieldError("design", "kind", repr(self.kind), f"one of {listing(get_args(Kind))}")
        spread = self.kind not in ("grid", "list")
        if spread != (self.samples is not None):
            raise SceneError(f"design {self.kind}: give samples with random, sobol and latin_hypercube only")
        if self.samples is not None and not 1 <= self.samples <= MOST_RUNS:
            raise FieldError("design", "samples", self.samples, f"between 1 and {MOST_RUNS}")
        if self.seed < 0:
            raise FieldError("design", "seed", self.seed, ">= 0")


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandStep:
    """Joint commands from a time on.

    Attributes:
        time: Time in [s] from which they apply.
        pose: A pose of the robot by its name; None: `joints`.
        joints: Joint positions by name in their units, numbers or expressions; other joints keep their
            commands.
        base_shift: Shift of all joint bases in [m], a number or an expression; None: as before.
    """

    time: float = 0.0
    pose: str | None = None
    joints: dict[str, Any] = field(default_factory=dict)
    base_shift: Any = None

    def __post_init__(self) -> None:
        if not 0.0 <= self.time < math.inf:
            raise FieldError("command", "time", self.time, ">= 0 s")


@dataclass(frozen=True, slots=True, kw_only=True)
class QuantityDescription:
    """A quantity to measure in each run.

    Attributes:
        name: Name of the result in the store.
        of: The quantity, such as "effector.position"; "python" with `function`.
        at: "end"; "max", "min" or "mean" over the steps of the run; "series": every `every` seconds.
        every: Time between values of a series in [s]; None: every step.
        function: FILE.py:NAME, a function of the simulation that returns a number; relative to the study.
        unit: Unit of the function's result; other quantities know theirs.
        samples: Number of equilibria for a quantity of the workspace.
        most_effort: For the workspace, only poses that joints reach with no more, in [N m] or [N]; None: all.
    """

    name: str
    of: str
    at: At = "end"
    every: float | None = None
    function: str | None = None
    unit: str | None = None
    samples: int = 30
    most_effort: float | None = None

    def __post_init__(self) -> None:
        owner = f"quantity {self.name}"
        need_word(owner, self.name)
        if self.at not in get_args(At):
            raise FieldError(owner, "at", repr(self.at), f"one of {listing(get_args(At))}")
        if self.every is not None:
            need_positive(owner, "every", self.every, "s")
            if self.at != "series":
                raise FieldError(owner, "every", self.every, "given with at: series only")
        if (self.of == "python") != (self.function is not None):
            raise SceneError(f"{owner}: `of: python` and `function: FILE.py:NAME` belong together")
        if self.function is not None and not all(self.function.partition(".py:")):
            raise FieldError(owner, "function", repr(self.function), "FILE.py:NAME")
        if self.unit is not None and self.function is None:
            raise FieldError(owner, "unit", repr(self.unit), "given with a function only")
        if self.samples < 4:
            raise FieldError(owner, "samples", self.samples, ">= 4")
        if self.most_effort is not None:
            need_positive(owner, "most_effort", self.most_effort, "N m or N")


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectiveDescription:
    """Objective of `softsim optimise`; give one of the two.

    Attributes:
        minimise, maximise: An expression of quantities with one value and of variables, such as "= sag".
        generations: Number of generations.
        population: Runs of a generation; None: 4 + 3 ln p, as is usual.
        spread: Standard deviation of the first generation, as a share of the bounds.
        seed: Seed of the samples.
    """

    minimise: str | None = None
    maximise: str | None = None
    generations: int = 20
    population: int | None = None
    spread: float = 0.25
    seed: int = 0

    def __post_init__(self) -> None:
        if (self.minimise is None) == (self.maximise is None):
            raise SceneError("objective: give exactly one of minimise and maximise")
        if not self.expression.startswith("="):
            raise FieldError(
                "objective", "expression", repr(self.expression), "an expression, such as '= sag'"
            )
        if not 1 <= self.generations <= 100_000:
            raise FieldError("objective", "generations", self.generations, "between 1 and 100000")
        if self.population is not None and not 4 <= self.population <= 100_000:
            raise FieldError("objective", "population", self.population, "between 4 and 100000")
        if not 0.0 < self.spread <= 1.0:
            raise FieldError("objective", "spread", self.spread, "in (0, 1]")
        if self.seed < 0:
            raise FieldError("objective", "seed", self.seed, ">= 0")

    @property
    def expression(self) -> str:
        """The expression to minimise or maximise."""
        return self.minimise if self.minimise is not None else self.maximise or ""

    @property
    def sign(self) -> float:
        """Sign of the objective: +1 for a minimum, -1 for a maximum."""
        return 1.0 if self.minimise is not None else -1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyDescription:
    """Many runs of one scene.

    Attributes:
        name: Name in messages and in the store.
        scene: A robot or scene: a name, or a file relative to the study.
        variables: The variables.
        measure: Quantities to measure in each run.
        about: One sentence for people.
        design: Combinations of the variables' values.
        overlay: Overrides of the scene, with expressions where a variable acts, such as "= 2 * stiffness".
        arguments: Passed to `create_scene` of a Python scene by name, numbers or expressions.
        command: Joint commands, in order of time; none: a run in time continues as it begins, an equilibrium
            is that in the pose at which the start move ends.
        duration: Duration of each run in [s]; None: it is the equilibrium under the first commands.
        begin: A run in time begins in the rest shape, or at that equilibrium.
        time_limit: Wall time limit of a run in [s]; a longer one is stopped.
        block: Runs per chunk of the store.
        objective: Objective of an optimisation; None: there is none.
        posterior: Parameter distribution of a calibration; its parameters are drawn, and are the first
            variables. In a file: the distribution's file, whose overlay is applied before the study's.
    """

    name: str
    scene: str
    variables: tuple[VariableDescription, ...]
    measure: tuple[QuantityDescription, ...]
    about: str = ""
    design: DesignDescription = DesignDescription()
    overlay: dict[str, Any] = field(default_factory=dict)
    arguments: dict[str, Any] = field(default_factory=dict)
    command: tuple[CommandStep, ...] = ()
    duration: float | None = None
    begin: Begin = "rest"
    time_limit: float = 600.0
    block: int = 64
    objective: ObjectiveDescription | None = None
    posterior: DistributionDescription | None = None

    def __post_init__(self) -> None:
        owner = f"study {self.name}"
        need_word(owner, self.name)
        names = [*(each.name for each in self.variables), *(each.name for each in self.measure)]
        if not self.variables or not self.measure:
            raise SceneError(f"{owner}: give one variable or more, and one quantity or more to measure")
        taken = {"run", "status", "error", "time", "axis", "objective"}
        for name in names:
            if names.count(name) > 1 or name in taken:
                raise SceneError(
                    f"{owner}: the name {name!r} is taken; give each variable and quantity its own"
                )
        self._need_names_used(owner)
        if self.duration is not None:
            need_positive(owner, "duration", self.duration, "s")
        need_positive(owner, "time_limit", self.time_limit, "s")
        if not 1 <= self.block <= 100_000:
            raise FieldError(owner, "block", self.block, "between 1 and 100000")
        if self.begin not in get_args(Begin):
            raise FieldError(owner, "begin", repr(self.begin), f"one of {listing(get_args(Begin))}")
        times = [each.time for each in self.command]
        if times != sorted(set(times)):
            raise FieldError(owner, "command", times, "steps in order of time, each at its own")
        if self.duration is None:
            for each in self.measure:
                if each.at != "end":
                    raise FieldError(
                        owner, "measure", f"{each.name} at {each.at}", "at end without a duration"
                    )
            if len(self.command) > 1:
                raise SceneError(f"{owner}: an equilibrium has one command; give a duration for several")
        if self.posterior is not None and (self.design.samples is None or self.objective is not None):
            raise SceneError(f"{owner}: a posterior is drawn from: give a design with samples, no objective")
        if self.objective is not None:
            for variable in self.variables:
                if variable.lower is None:
                    raise SceneError(
                        f"{owner}: variable {variable.name} needs lower and upper to be optimised"
                    )

    def _need_names_used(self, owner: str) -> None:
        variables = [each.name for each in self.variables]
        commands = [[each.joints, each.base_shift] for each in self.command]
        used = names_in([self.overlay, self.arguments, commands])
        for name in sorted(used - set(variables)):
            raise SceneError(f"{owner}: an expression names {name!r}; the variables are {listing(variables)}")
        for name in variables:
            if name not in used:
                raise SceneError(f"{owner}: variable {name} stands in no expression; use or remove it")
        if self.objective is not None:
            everything = [*variables, *(each.name for each in self.measure if each.at != "series")]
            for name in sorted(names_in(self.objective.expression) - set(everything)):
                raise SceneError(f"{owner}: the objective names {name!r}; there are {listing(everything)}")


def need_word(owner: str, name: object) -> None:
    """Reject a name that is not a word of letters, digits and _.

    Raises:
        FieldError: it is none.
    """
    if not (isinstance(name, str) and name.isidentifier() and name.isascii()):
        raise FieldError(owner, "name", repr(name), "a word of letters, digits and _")


def load_study(file: str | Path) -> StudyDescription:
    """Load a study from its file, or by the name of one that came with the suite.

    Raises:
        ConfigError: the file does not exist, or any problem in it, as one message.
    """
    path = find_study(file)
    data = read_extended(path)
    if isinstance(data.get("posterior"), str):
        data = _with_posterior(data, path)
    return structure_description(data, StudyDescription, path, find_files=False)


def _with_posterior(data: SourcedMapping, path: Path) -> SourcedMapping:
    """Add a named distribution to a study: its parameters as variables, and its overlay below the study's."""
    file = relative_to_file(data["posterior"], path)
    posterior = load_distribution(file)
    robot = relative_to_file(posterior.robot, file)
    parameters = zip(posterior.names, posterior.units, posterior.lower, posterior.upper, strict=True)
    drawn = [
        {"name": name, "unit": unit, "lower": low, "upper": high} for name, unit, low, high in parameters
    ]
    whole = {
        "scene": os.path.relpath(robot, path.parent) if robot.is_file() else posterior.robot,
        **data,
        "variables": [*drawn, *(data.get("variables") or ())],
        "overlay": laid_over(posterior.overlay, data.get("overlay") or {}),
        "posterior": given_values(posterior),
    }
    return cast(SourcedMapping, mark_source(whole, path))


def find_study(file: str | Path) -> Path:
    """Return the file of a study: the given path, or the file of a name that came with the suite.

    Raises:
        ConfigError: neither exists.
    """
    studies = known_studies()
    if str(file) in studies:
        return studies[str(file)].absolute()
    try:
        path = Path(file).expanduser().absolute()
        if path.is_file():
            return path
    except (OSError, RuntimeError, ValueError):
        pass
    raise ConfigError(
        f"{file!s:.100}", "", f"no such file, and no study of that name; known: {listing(studies)}"
    )


def known_studies() -> dict[str, Path]:
    """Return names and files of the studies below the config roots, sorted."""
    studies: dict[str, Path] = {}
    for root in config_roots():
        for path in sorted((root / "studies").glob("*.yaml")):
            studies.setdefault(path.stem, path)
    return dict(sorted(studies.items()))
