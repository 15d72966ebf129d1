"""Write docs/library.md: what `softsim_core` gives a user, a line each, from the docstrings.

From the checkout: `.softsim/venv/bin/python docs/library.py`.
"""

from __future__ import annotations

import inspect
import re
import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
sys.path.insert(0, str(FOLDER.parent))

import softsim_core as core  # noqa: E402

GROUPS: dict[str, str] = {
    "Running": (
        "Simulation load_scene known_scenes find_config Batch RunningSimulation StepReport StaticSolution "
        "ContactReport CableView ChamberView"
    ),
    "What is simulated": (
        "SceneDescription BodyDescription MaterialDescription JointDescription JointLimits CableDescription "
        "MaterialRegionDescription LayerDescription FibresDescription AxisDescription "
        "RodDescription RodSectionDescription LayerOfRodDescription RodClampDescription "
        "TendonArmDescription TendonSegment Backbone Tendon tendon_arm "
        "ChamberDescription LoadDescription AddedMassDescription AttachmentDescription RigidBodyDescription "
        "Shape CollisionDescription ContactSettings SolverSettings Placement Box Sphere MeshFile"
    ),
    "What is felt": (
        "SimulatedSensorDescription WrenchSensorDescription ForceTorqueDescription TactileArrayDescription "
        "StrainSensorDescription "
        "ImuDescription MarkersDescription CableSensorDescription ChamberSensorDescription SensorReading "
        "register_sensor Sensor StepObservation Scenery"
    ),
    "Actuators of one's own": (
        "Actuator ActuatorDescription register_actuator Surroundings Placed line_stiffness "
        "GeometricStiffness ActuatorView ActuatorKind"
    ),
    "The robot around it": (
        "RobotDescription CommandSettings StartAnimation KeyBinding BoardDescription "
        "BusServo ServoCalibration "
        "InverseSettings ViewSettings Camera Section Controller ArmDescription ToolDescription arm_with_tools"
    ),
    "Scenes in Python": "Scene Part animated",
    "Meshes": (
        "TetMesh SurfaceMesh box_mesh read_tets read_surface check_tets boundary_surface surface_of "
        "write_tets write_surface"
    ),
    "MuJoCo models": "import_mjcf ImportedScene write_imported export_mjcf ExportedModel",
    "Poses and rotations": (
        "Pose rotation_of quaternion_of rotation_euler rotation_exp rotation_log tilt_rotation tilts_of"
    ),
    "Inverse control": (
        "InverseController InverseReport solve_pose PoseSolution PositionTask OrientationTask HeightTiltTask "
        "PoseTask Sensitivity analytic_sensitivity sampled_sensitivity sample_workspace Workspace "
        "TiltController TiltGains reach"
    ),
    "Models beside measurements": (
        "known_data_sets load_data_set DataSet load_session Session session_robot validate_session "
        "load_calibration calibrate Calibration Ending CalibrationDescription ParameterDescription "
        "cross_validated Folds profiled next_poses NextPoses distribution_of load_distribution "
        "DistributionDescription "
        "SessionResult Measures Alignment DataSetDescription DataFolder SessionDescription CommandColumns "
        "SensorDescription OtherModel TimeColumn FrameDescription AlignmentDescription SplitDescription "
        "ErrorLimits ModelDescription PublishedError league_entries LeagueEntry regression_errors"
    ),
    "Many runs": (
        "load_study StudyDescription VariableDescription DesignDescription CommandStep QuantityDescription "
        "ObjectiveDescription prepare_study PreparedStudy sweep SweepOptions Where StudySummary read_results "
        "StudyResults RandomisationDescription SpreadDescription"
    ),
    "Trained policies": "load_policy Policy policy_metadata",
    "Paths": "EffectorPath read_path JointTrajectory",
    "Errors": (
        "SoftSimError SceneError FieldError ArrayError BatchError ConfigError DataError MeshError MjcfError "
        "MaterialError CommandError PathRefusedError SnapshotError SolverDivergedError FactorisationError "
        "DetectionOverflowError NotConvergedError NotReachedError PolicyError StudyError "
        "LockError RuntimeFolderError"
    ),
    "Version": "__version__",
}
"""Every name of the package, in the order in which a reader looks for it."""

HEAD = """# The library

Made from the program's own docstrings by [library.py](library.py).

Everything here is imported from one place:

```python
from softsim_core import Simulation, load_scene

simulation = Simulation(load_scene("tripod"))
simulation.step()
```

`dir(softsim_core)` lists the same names, `help(name)` says the rest of each: shapes, units, errors.
Importing the package loads neither SciPy nor Numba; the first use of a name loads its module.
[beam_from_scratch.py](../examples/beam_from_scratch.py) builds a beam without any file. Ready-made
parts (`softsim_core.robots.parts`, `softsim_core.robots.gripper_parts`) and the keys of scene files
stand in [Parts and sections](tutorials/reference.md).
"""


def line_of(name: str) -> str:
    """What a name is: the first sentence of its docstring."""
    if name == "__version__":
        return "The version of the package, as text."
    text = " ".join((inspect.getdoc(getattr(core, name)) or "").split("\n\n")[0].split())
    return re.split(r"(?<=\.) (?=[A-Z])", text)[0].replace("|", "\\|")


def page() -> str:
    """The whole page."""
    blocks = [HEAD.strip()]
    for title, names in GROUPS.items():
        rows = [f"| `{name}` | {line_of(name)} |" for name in names.split()]
        blocks.append("\n".join([f"## {title}", "", "| name | |", "|---|---|", *rows]))
    return "\n\n".join(blocks) + "\n"


if __name__ == "__main__":
    (FOLDER / "library.md").write_text(page(), encoding="utf-8")
