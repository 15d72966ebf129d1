"""Python scenes: parts and controllers, validation as in YAML, errors with file and line."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from pathlib import Path
from textwrap import dedent

import pytest

from softsim_core.base import CommandError, ConfigError, SceneError
from softsim_core.physics.mesh import TetMesh
from softsim_core.scene import JointDescription, Part, Scene, animated, load_python, load_scene
from softsim_core.scene.io import MODULES


def write(folder: Path, text: str, name: str = "own.py") -> Path:
    path = folder / name
    path.write_text(dedent(text).lstrip())
    return path


def refusal(path: Path) -> ConfigError:
    with pytest.raises(ConfigError) as caught:
        load_python(path)
    assert caught.value.file == str(path)
    return caught.value


class Clock:
    """Time and step size of a simulation, all that an animation reads."""

    def __init__(self, dt: float = 0.01) -> None:
        self.dt, self.step_count = dt, 0

    @property
    def time(self) -> float:
        return self.step_count * self.dt


def test_a_users_file_builds_a_scene(tmp_path: Path) -> None:
    (tmp_path / "body.vtk").touch()
    path = write(
        tmp_path,
        """
        from beside import NAME
        from softsim_core.scene import SolverSettings
        from softsim_core.robots import elastic_body, fixing_box, servo

        def create_scene(scene):
            scene.name = NAME
            scene.dt = 0.002
            scene.gravity = [0, 0, -1.62]
            scene.solver = SolverSettings(rotation="qr")
            scene.add([elastic_body("block", "body.vtk"), fixing_box("hold", "block", (0, 0, 0), (1, 1, 1))])
            scene.add(servo("left"))
            scene.add(servo("right"))
            scene.poses["up"] = [0, 1]
        """,
    )
    write(tmp_path, "NAME = 'mine'", "beside.py")
    before = list(sys.path)
    scene = load_scene(path)
    assert sys.path == before
    assert (scene.name, scene.scene.dt, scene.scene.gravity) == ("mine", 0.002, (0.0, 0.0, -1.62))
    assert scene.scene.solver.rotation == "qr"
    assert scene.joint_names == ("left", "right")
    assert scene.poses == {"up": (0.0, 1.0)}
    assert scene.scene.bodies[0].mesh.file == tmp_path / "body.vtk"  # type: ignore[union-attr]
    assert scene.source == path
    assert not (tmp_path / "__pycache__" / "own.pyc").exists()


def test_meshes_may_be_arrays(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        """
        import numpy as np
        from softsim_core.physics.mesh import TetMesh
        from softsim_core.robots import elastic_body

        MESH = TetMesh(points=np.eye(4, 3), tets=np.array([[0, 1, 2, 3]]))

        def create_scene(scene):
            scene.add(elastic_body("block", MESH, np.float32(1000.0), total_mass=np.int64(2)))
        """,
    )
    body = load_scene(path, {"dt": 0.1}).scene.bodies[0]
    assert isinstance(body.mesh, TetMesh)
    assert (type(body.material.young_modulus), type(body.total_mass)) == (float, float)


def test_the_name_defaults_to_the_files(tmp_path: Path) -> None:
    assert load_python(write(tmp_path, "def create_scene(scene): pass", "empty.py")).name == "empty"


def test_a_changed_file_is_read_again(tmp_path: Path) -> None:
    path = write(tmp_path, "def create_scene(scene): scene.dt = 1.0")
    assert load_python(path).scene.dt == 1.0
    write(tmp_path, "def create_scene(scene): scene.dt = 2.0")
    assert load_python(path).scene.dt == 2.0


def test_overrides(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        """
        from softsim_core.robots import servo

        def create_scene(scene):
            scene.add(servo("a"))
            scene.on_step_end(print)
        """,
    )
    scene = load_scene(path, {"dt": 0.5, "joints": [{"name": "a", "rest": 1.0}]})
    assert (scene.scene.dt, scene.joints[0].rest) == (0.5, 1.0)
    assert [each.on_end is not None for each in scene.controllers] == [True]


@pytest.mark.parametrize(
    ("body", "key", "words"),
    [
        ("scene.add(1 / 0)", "line 3", ["ZeroDivisionError"]),
        ("helper()", "line 3", ["NameError", "helper"]),
        ("scene.dtt = 3", "line 3", ["dtt"]),
        ("scene.add(3)", "line 3", ["cannot add 3"]),
        ("scene.add(servo('a', limits=JointLimits(2.0, 1.0)))", "line 3", ["lower <= upper"]),
        ("scene.add(elastic_body('a', 'a.vtk', total_mass=-1.0))", "line 3", ["total_mass", "> 0 kg"]),
        ("raise SystemExit(3)", "line 3", ["SystemExit"]),
        ("load_scene('gone')", "line 3", ["gone", "no such file"]),
        ("scene.dt = -1.0", "", ["dt", "> 0 s", "-1.0"]),
        ("scene.dt = 'fast'", "", ["wrong type"]),
        ("scene.name = 3", "", ["name", "letters"]),
        ("scene.gravity = (0.0, 1.0)", "gravity", ["3 numbers"]),
        ("scene.add([servo('a'), servo('a')])", "", ["two", "joint", "a"]),
        ("scene.effector = 'tip'", "", ["effector", "'tip'"]),
        ("scene.poses = {'up': [1.0]}", "", ["pose up has 1 values for 0 joints"]),
        ("scene.poses = {'up': 3}", "", ["wrong type"]),
        ("scene.bodies = None", "", ["wrong type"]),
        ("scene.add(elastic_body('a', 'gone.vtk'))", "bodies[0].mesh.file", ["no such mesh file", "own.py"]),
        (
            "scene.add(servo('a', Placement(rotation_deg=(0.0, 0.0))))",
            "joints[0].base.rotation_deg",
            ["3 numbers"],
        ),
        ("scene.add(elastic_body('a', MeshFile(file=3)))", "bodies[0].mesh.file", ["a file path, not 3"]),
        ("scene.keys = {'a': 3}", "", ["wrong type"]),
    ],
)
def test_mistakes_in_the_file(tmp_path: Path, body: str, key: str, words: list[str]) -> None:
    text = (
        "from softsim_core.robots.parts import *; from softsim_core.scene import load_scene\n"
        f"def create_scene(scene):\n    {body}\n"
    )
    error = refusal(write(tmp_path, text))
    assert error.key == key
    assert "\n" not in str(error)
    for word in words:
        assert word in str(error)


@pytest.mark.parametrize(
    ("text", "key", "words"),
    [
        ("x = 3\n", "", ["create_scene(scene)"]),
        ("create_scene = 3\n", "", ["create_scene(scene)"]),
        ("def create_scene(scene:\n    pass\n", "line 1", ["Python syntax"]),
        ("import gone_module\n", "line 1", ["gone_module"]),
        ("def create_scene():\n    pass\n", "", ["TypeError", "create_scene"]),
        ("def create_scene(scene):\n    import broken\n", "line 2", ["Python syntax", "broken.py, line 1"]),
        ("def create_scene(scene):\n    exec('x = (')\n", "line 2", ["Python syntax"]),
        ("def create_scene(scene):\n    raise ValueError\n", "line 2", ["ValueError"]),
        ("x = '\0'", "", ["null byte"]),
    ],
)
def test_files_that_do_not_run(tmp_path: Path, text: str, key: str, words: list[str]) -> None:
    write(tmp_path, "x = (\n", "broken.py")
    error = refusal(write(tmp_path, text))
    assert error.key == key
    for word in words:
        assert word in str(error)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("from softsim_core.scene.parts import servo", "import softsim_core.robots.parts in its place"),
        ("from softsim_core.scene import parts", "import softsim_core.robots.parts in its place"),
        (
            "from softsim_core.contact.crossing import x",
            "moved into another one below softsim_core.physics.contact; see docs/library.md",
        ),
        ("import softsim_core.dynamics.simulation", "import softsim_core.simulation in its place"),
        (
            "from softsim_core.scene.description import KeyBinding",
            "not in softsim_core.scene.description any more; write `from softsim_core import KeyBinding`",
        ),
        ("from softsim_core.physics.mesh import nothing", "ImportError: cannot import name 'nothing'"),
        ("import softsim_core.nothing", "ModuleNotFoundError: No module named 'softsim_core.nothing'"),
    ],
)
def test_what_has_moved_is_named_with_its_new_place(tmp_path: Path, line: str, words: str) -> None:
    error = refusal(write(tmp_path, f"{line}\n\ndef create_scene(scene): pass\n"))
    assert error.key == "line 1"
    assert words in error.problem


def test_every_module_that_moved_has_gone_from_its_old_place_and_is_at_the_new_one() -> None:
    for old, new in MODULES.items():
        with pytest.raises(ModuleNotFoundError):
            importlib.import_module(old)
        assert importlib.util.find_spec(new) is not None


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    assert "cannot be read" in refusal(tmp_path / "gone.py").problem


def test_ctrl_c_passes(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        load_python(write(tmp_path, "def create_scene(scene): raise KeyboardInterrupt"))


def test_controllers_are_kept_in_order() -> None:
    scene = Scene()
    calls: list[object] = []

    @scene.on_step_begin
    def begin(simulation: object) -> None:
        calls.append(("begin", simulation))

    @scene.on_step_end
    def end(simulation: object) -> None:
        calls.append(("end", simulation))

    @scene.on_key
    def key(simulation: object, name: str) -> None:
        calls.append((name, simulation))

    first, second, third = scene.describe().controllers
    assert first.on_begin is begin
    assert second.on_end is end
    assert third.on_key is key
    third.on_key(1, "up")  # type: ignore[arg-type]
    assert calls == [("up", 1)]


def test_a_failing_controller_names_its_line(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        """
        from softsim_core.base import CommandError

        def create_scene(scene):
            @scene.on_step_end
            def fail(simulation):
                1 / 0

            @scene.on_key
            def refuse(simulation, key):
                raise CommandError("refused")

            @scene.on_step_begin
            def stop(simulation):
                raise KeyboardInterrupt
        """,
    )
    fail, refuse, stop = load_python(path).controllers
    with pytest.raises(SceneError, match=r"own\.py: line 6: controller failed: ZeroDivisionError"):
        fail.on_end(None)  # type: ignore[arg-type,misc]
    with pytest.raises(CommandError, match=r"^refused$"):
        refuse.on_key(None, "a")  # type: ignore[arg-type,misc]
    with pytest.raises(KeyboardInterrupt):
        stop.on_begin(None)  # type: ignore[arg-type,misc]


def test_a_second_effector_is_refused() -> None:
    scene = Scene()
    scene.add(Part(effector="a"))
    scene.add(Part(joints=(JointDescription(name="b"),), effector="a"))
    with pytest.raises(SceneError, match="already has the effector a, cannot add b"):
        scene.add(Part(effector="b"))


@pytest.mark.parametrize(
    ("mode", "delay"), [("once", 0.0), ("once", 0.05), ("loop", 0.0), ("pingpong", 0.03)]
)
def test_animations_follow_the_simulated_time(mode: str, delay: float) -> None:
    clock, factors = Clock(), []
    controller = animated(lambda _, factor: factors.append(factor), 0.2, mode, delay)  # type: ignore[arg-type]
    for clock.step_count in range(60):
        controller.on_begin(clock)  # type: ignore[arg-type,misc]
    rise = [step / 20 for step in range(21)]
    first = round(delay / clock.dt)
    expected = {
        "once": rise,
        "loop": rise + rise[1:] * 2,
        "pingpong": rise + rise[-2::-1] + rise[1:],
    }[mode]
    assert factors == expected[: 60 - first]
    played, clock.step_count = list(factors), 0
    factors.clear()
    for clock.step_count in range(60):  # after a reset it plays again, call for call
        controller.on_begin(clock)  # type: ignore[arg-type,misc]
    assert factors == played


@pytest.mark.parametrize(
    ("arguments", "words"), [((0.0,), "duration"), ((1.0, "twice"), "mode"), ((1.0, "once", -1.0), "delay")]
)
def test_animation_arguments_are_checked(arguments: tuple[object, ...], words: str) -> None:
    with pytest.raises(SceneError, match=words):
        Scene().animate(lambda simulation, factor: None, *arguments)  # type: ignore[arg-type]
