"""Soft-robot physics: finite elements, rigid frames, joints, contact. NumPy arrays in and out, SI units.

What a user of the library needs stands here: `from softsim_core import ...`; docs/library.md has a line on
each name. Importing the package loads none of it: a name brings its module when it is first asked for.
"""

import sys

# `python -m softsim_core.simulation.warmup` puts the current folder first on the import path. Where this
# package lies elsewhere no module may come from there, so this stands before the first import that could.
if (
    sys.argv[:1] == ["-m"]
    and not (sys.flags.isolated or getattr(sys.flags, "safe_path", False))
    and sys.path[0] != __file__.rpartition("/softsim_core/")[0]
):
    del sys.path[0]

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

from softsim_core.base.moved import keep_former_names

if TYPE_CHECKING:
    from softsim_core.base.errors import (
        ArrayError,
        BatchError,
        CommandError,
        ConfigError,
        DataError,
        DetectionOverflowError,
        FactorisationError,
        MaterialError,
        MeshError,
        MjcfError,
        NotConvergedError,
        NotReachedError,
        PolicyError,
        SceneError,
        SnapshotError,
        SoftSimError,
        SolverDivergedError,
        StudyError,
    )
    from softsim_core.base.files import LockError, RuntimeFolderError
    from softsim_core.base.values import Box, FieldError, MeshFile, Placement, Sphere
    from softsim_core.control.inverse.closed_loop import TiltController, TiltGains, tilt_rotation, tilts_of
    from softsim_core.control.inverse.controller import InverseController, InverseReport
    from softsim_core.control.inverse.paths import EffectorPath, PathRefusedError, read_path
    from softsim_core.control.inverse.sensitivity import (
        Sensitivity,
        analytic_sensitivity,
        sampled_sensitivity,
    )
    from softsim_core.control.inverse.static import PoseSolution, solve_pose
    from softsim_core.control.inverse.tasks import HeightTiltTask, OrientationTask, PoseTask, PositionTask
    from softsim_core.control.inverse.workspace import Workspace, reach, sample_workspace
    from softsim_core.lab.identification.alignment import Alignment
    from softsim_core.lab.identification.calibration import (
        CalibrationDescription,
        ParameterDescription,
        load_calibration,
    )
    from softsim_core.lab.identification.confidence import (
        DistributionDescription,
        Folds,
        cross_validated,
        distribution_of,
        load_distribution,
        profiled,
    )
    from softsim_core.lab.identification.description import (
        AlignmentDescription,
        CommandColumns,
        DataFolder,
        DataSetDescription,
        ErrorLimits,
        FrameDescription,
        OtherModel,
        SensorDescription,
        SessionDescription,
        SplitDescription,
        TimeColumn,
    )
    from softsim_core.lab.identification.excitation import NextPoses, next_poses
    from softsim_core.lab.identification.files import DataSet, known_data_sets, load_data_set
    from softsim_core.lab.identification.fit import Calibration, Ending, calibrate
    from softsim_core.lab.identification.measures import Measures
    from softsim_core.lab.identification.session import Session, load_session
    from softsim_core.lab.identification.validation import SessionResult, session_robot, validate_session
    from softsim_core.lab.learning.policy import Policy, load_policy, policy_metadata
    from softsim_core.lab.learning.randomisation import RandomisationDescription, SpreadDescription
    from softsim_core.lab.study.description import (
        CommandStep,
        DesignDescription,
        ObjectiveDescription,
        QuantityDescription,
        StudyDescription,
        VariableDescription,
        load_study,
    )
    from softsim_core.lab.study.engine import StudySummary, SweepOptions, Where, sweep
    from softsim_core.lab.study.preparing import PreparedStudy, prepare_study
    from softsim_core.lab.study.store import StudyResults, read_results
    from softsim_core.mjcf.exporting import ExportedModel, export_mjcf
    from softsim_core.mjcf.importing import ImportedScene, import_mjcf, write_imported
    from softsim_core.physics.actuation import (
        Actuator,
        ActuatorDescription,
        ActuatorKind,
        ActuatorView,
        GeometricStiffness,
        Placed,
        Surroundings,
        register_actuator,
    )
    from softsim_core.physics.actuation.cable import CableDescription, CableView
    from softsim_core.physics.actuation.cable.cables import line_stiffness
    from softsim_core.physics.actuation.chamber import ChamberDescription, ChamberView
    from softsim_core.physics.actuation.trajectory import JointTrajectory
    from softsim_core.physics.contact.settings import ContactSettings
    from softsim_core.physics.dynamics.report import ContactReport, StepReport
    from softsim_core.physics.dynamics.statics import StaticSolution
    from softsim_core.physics.mechanics.limits import JointLimits
    from softsim_core.physics.mechanics.pose import (
        Pose,
        quaternion_of,
        rotation_euler,
        rotation_exp,
        rotation_log,
        rotation_of,
    )
    from softsim_core.physics.mesh import (
        SurfaceMesh,
        TetMesh,
        boundary_surface,
        box_mesh,
        check_tets,
        read_surface,
        read_tets,
        write_surface,
        write_tets,
    )
    from softsim_core.physics.mesh.shapes import Shape, surface_of
    from softsim_core.physics.sensing import (
        CableSensorDescription,
        ChamberSensorDescription,
        ForceTorqueDescription,
        ImuDescription,
        MarkersDescription,
        Scenery,
        Seen,
        Sensor,
        SensorReading,
        SimulatedSensorDescription,
        StrainSensorDescription,
        TactileArrayDescription,
        WrenchSensorDescription,
        register_sensor,
    )
    from softsim_core.scene import find_config, known_scenes, load_scene
    from softsim_core.scene.arm.description import ArmDescription, ToolDescription
    from softsim_core.scene.arm.mounting import arm_with_tools
    from softsim_core.scene.board import BoardDescription, BusServo, ServoCalibration
    from softsim_core.scene.control import CommandSettings, InverseSettings, KeyBinding, StartAnimation
    from softsim_core.scene.deformable import (
        AddedMassDescription,
        AttachmentDescription,
        BodyDescription,
        MaterialRegionDescription,
    )
    from softsim_core.scene.description import (
        CollisionDescription,
        RigidBodyDescription,
        SceneDescription,
        SolverSettings,
    )
    from softsim_core.scene.joint import JointDescription
    from softsim_core.scene.material import MaterialDescription
    from softsim_core.scene.robot import Controller, RobotDescription, RunningSimulation
    from softsim_core.scene.rod import (
        AxisDescription,
        FibresDescription,
        LayerDescription,
        LayerOfRodDescription,
        RodClampDescription,
        RodDescription,
        RodSectionDescription,
    )
    from softsim_core.scene.scene import Part, Scene, animated
    from softsim_core.scene.view import Camera, Section, ViewSettings
    from softsim_core.simulation import Simulation
    from softsim_core.simulation.batch import Batch

__version__ = "0.1.0"

__all__ = [
    "Actuator",
    "ActuatorDescription",
    "ActuatorKind",
    "ActuatorView",
    "AddedMassDescription",
    "Alignment",
    "AlignmentDescription",
    "ArmDescription",
    "ArrayError",
    "AttachmentDescription",
    "AxisDescription",
    "Batch",
    "BatchError",
    "BoardDescription",
    "BodyDescription",
    "Box",
    "BusServo",
    "CableDescription",
    "CableSensorDescription",
    "CableView",
    "Calibration",
    "CalibrationDescription",
    "Camera",
    "ChamberDescription",
    "ChamberSensorDescription",
    "ChamberView",
    "CollisionDescription",
    "CommandColumns",
    "CommandError",
    "CommandSettings",
    "CommandStep",
    "ConfigError",
    "ContactReport",
    "ContactSettings",
    "Controller",
    "DataError",
    "DataFolder",
    "DataSet",
    "DataSetDescription",
    "DesignDescription",
    "DetectionOverflowError",
    "DistributionDescription",
    "EffectorPath",
    "Ending",
    "ErrorLimits",
    "ExportedModel",
    "FactorisationError",
    "FibresDescription",
    "FieldError",
    "Folds",
    "ForceTorqueDescription",
    "FrameDescription",
    "GeometricStiffness",
    "HeightTiltTask",
    "ImportedScene",
    "ImuDescription",
    "InverseController",
    "InverseReport",
    "InverseSettings",
    "JointDescription",
    "JointLimits",
    "JointTrajectory",
    "KeyBinding",
    "LayerDescription",
    "LayerOfRodDescription",
    "LockError",
    "MarkersDescription",
    "MaterialDescription",
    "MaterialError",
    "MaterialRegionDescription",
    "Measures",
    "MeshError",
    "MeshFile",
    "MjcfError",
    "NextPoses",
    "NotConvergedError",
    "NotReachedError",
    "ObjectiveDescription",
    "OrientationTask",
    "OtherModel",
    "ParameterDescription",
    "Part",
    "PathRefusedError",
    "Placed",
    "Placement",
    "Policy",
    "PolicyError",
    "Pose",
    "PoseSolution",
    "PoseTask",
    "PositionTask",
    "PreparedStudy",
    "QuantityDescription",
    "RandomisationDescription",
    "RigidBodyDescription",
    "RobotDescription",
    "RodClampDescription",
    "RodDescription",
    "RodSectionDescription",
    "RunningSimulation",
    "RuntimeFolderError",
    "Scene",
    "SceneDescription",
    "SceneError",
    "Scenery",
    "Section",
    "Seen",
    "Sensitivity",
    "Sensor",
    "SensorDescription",
    "SensorReading",
    "ServoCalibration",
    "Session",
    "SessionDescription",
    "SessionResult",
    "Shape",
    "SimulatedSensorDescription",
    "Simulation",
    "SnapshotError",
    "SoftSimError",
    "SolverDivergedError",
    "SolverSettings",
    "Sphere",
    "SplitDescription",
    "SpreadDescription",
    "StartAnimation",
    "StaticSolution",
    "StepReport",
    "StrainSensorDescription",
    "StudyDescription",
    "StudyError",
    "StudyResults",
    "StudySummary",
    "SurfaceMesh",
    "Surroundings",
    "SweepOptions",
    "TactileArrayDescription",
    "TetMesh",
    "TiltController",
    "TiltGains",
    "TimeColumn",
    "ToolDescription",
    "VariableDescription",
    "ViewSettings",
    "Where",
    "Workspace",
    "WrenchSensorDescription",
    "__version__",
    "analytic_sensitivity",
    "animated",
    "arm_with_tools",
    "boundary_surface",
    "box_mesh",
    "calibrate",
    "check_tets",
    "cross_validated",
    "distribution_of",
    "export_mjcf",
    "find_config",
    "import_mjcf",
    "known_data_sets",
    "known_scenes",
    "line_stiffness",
    "load_calibration",
    "load_data_set",
    "load_distribution",
    "load_policy",
    "load_scene",
    "load_session",
    "load_study",
    "next_poses",
    "policy_metadata",
    "prepare_study",
    "profiled",
    "quaternion_of",
    "reach",
    "read_path",
    "read_results",
    "read_surface",
    "read_tets",
    "register_actuator",
    "register_sensor",
    "rotation_euler",
    "rotation_exp",
    "rotation_log",
    "rotation_of",
    "sample_workspace",
    "sampled_sensitivity",
    "session_robot",
    "solve_pose",
    "surface_of",
    "sweep",
    "tilt_rotation",
    "tilts_of",
    "validate_session",
    "write_imported",
    "write_surface",
    "write_tets",
]

_NAMES = {
    "softsim_core.base.errors": (
        "ArrayError BatchError CommandError ConfigError DataError DetectionOverflowError "
        "FactorisationError MaterialError MeshError MjcfError NotConvergedError NotReachedError "
        "PolicyError SceneError SnapshotError SoftSimError SolverDivergedError StudyError"
    ),
    "softsim_core.base.files": "LockError RuntimeFolderError",
    "softsim_core.base.values": "Box FieldError MeshFile Placement Sphere",
    "softsim_core.control.inverse.closed_loop": "TiltController TiltGains tilt_rotation tilts_of",
    "softsim_core.control.inverse.controller": "InverseController InverseReport",
    "softsim_core.control.inverse.paths": "EffectorPath PathRefusedError read_path",
    "softsim_core.control.inverse.sensitivity": "Sensitivity analytic_sensitivity sampled_sensitivity",
    "softsim_core.control.inverse.static": "PoseSolution solve_pose",
    "softsim_core.control.inverse.tasks": "HeightTiltTask OrientationTask PoseTask PositionTask",
    "softsim_core.control.inverse.workspace": "Workspace reach sample_workspace",
    "softsim_core.lab.identification.alignment": "Alignment",
    "softsim_core.lab.identification.calibration": (
        "CalibrationDescription ParameterDescription load_calibration"
    ),
    "softsim_core.lab.identification.confidence": (
        "DistributionDescription Folds cross_validated distribution_of load_distribution profiled"
    ),
    "softsim_core.lab.identification.description": (
        "AlignmentDescription CommandColumns DataFolder DataSetDescription ErrorLimits FrameDescription "
        "OtherModel SensorDescription SessionDescription SplitDescription TimeColumn"
    ),
    "softsim_core.lab.identification.excitation": "NextPoses next_poses",
    "softsim_core.lab.identification.files": "DataSet known_data_sets load_data_set",
    "softsim_core.lab.identification.fit": "Calibration Ending calibrate",
    "softsim_core.lab.identification.measures": "Measures",
    "softsim_core.lab.identification.session": "Session load_session",
    "softsim_core.lab.identification.validation": "SessionResult session_robot validate_session",
    "softsim_core.lab.learning.policy": "Policy load_policy policy_metadata",
    "softsim_core.lab.learning.randomisation": "RandomisationDescription SpreadDescription",
    "softsim_core.lab.study.description": (
        "CommandStep DesignDescription ObjectiveDescription QuantityDescription StudyDescription "
        "VariableDescription load_study"
    ),
    "softsim_core.lab.study.engine": "StudySummary SweepOptions Where sweep",
    "softsim_core.lab.study.preparing": "PreparedStudy prepare_study",
    "softsim_core.lab.study.store": "StudyResults read_results",
    "softsim_core.mjcf.exporting": "ExportedModel export_mjcf",
    "softsim_core.mjcf.importing": "ImportedScene import_mjcf write_imported",
    "softsim_core.physics.actuation": (
        "Actuator ActuatorDescription ActuatorKind ActuatorView GeometricStiffness Placed Surroundings "
        "register_actuator"
    ),
    "softsim_core.physics.actuation.cable": "CableDescription CableView",
    "softsim_core.physics.actuation.cable.cables": "line_stiffness",
    "softsim_core.physics.actuation.chamber": "ChamberDescription ChamberView",
    "softsim_core.physics.actuation.trajectory": "JointTrajectory",
    "softsim_core.physics.contact.settings": "ContactSettings",
    "softsim_core.physics.dynamics.report": "ContactReport StepReport",
    "softsim_core.physics.dynamics.statics": "StaticSolution",
    "softsim_core.physics.mechanics.limits": "JointLimits",
    "softsim_core.physics.mechanics.pose": (
        "Pose quaternion_of rotation_euler rotation_exp rotation_log rotation_of"
    ),
    "softsim_core.physics.mesh": (
        "SurfaceMesh TetMesh boundary_surface box_mesh check_tets read_surface read_tets write_surface "
        "write_tets"
    ),
    "softsim_core.physics.mesh.shapes": "Shape surface_of",
    "softsim_core.physics.sensing": (
        "CableSensorDescription ChamberSensorDescription ForceTorqueDescription ImuDescription "
        "MarkersDescription Scenery Seen Sensor SensorReading SimulatedSensorDescription "
        "StrainSensorDescription TactileArrayDescription WrenchSensorDescription register_sensor"
    ),
    "softsim_core.scene": "find_config known_scenes load_scene",
    "softsim_core.scene.arm.description": "ArmDescription ToolDescription",
    "softsim_core.scene.arm.mounting": "arm_with_tools",
    "softsim_core.scene.board": "BoardDescription BusServo ServoCalibration",
    "softsim_core.scene.control": "CommandSettings InverseSettings KeyBinding StartAnimation",
    "softsim_core.scene.deformable": (
        "AddedMassDescription AttachmentDescription BodyDescription MaterialRegionDescription"
    ),
    "softsim_core.scene.description": (
        "CollisionDescription RigidBodyDescription SceneDescription SolverSettings"
    ),
    "softsim_core.scene.joint": "JointDescription",
    "softsim_core.scene.material": "MaterialDescription",
    "softsim_core.scene.robot": "Controller RobotDescription RunningSimulation",
    "softsim_core.scene.rod": (
        "AxisDescription FibresDescription LayerDescription LayerOfRodDescription RodClampDescription "
        "RodDescription RodSectionDescription"
    ),
    "softsim_core.scene.scene": "Part Scene animated",
    "softsim_core.scene.view": "Camera Section ViewSettings",
    "softsim_core.simulation": "Simulation",
    "softsim_core.simulation.batch": "Batch",
}
"""What each module gives."""

MOVED: Final = {
    **{
        f"softsim_core.{name}": f"softsim_core.{group}.{name}"
        for group, names in {
            "physics": "actuation contact dynamics fem kernels linalg mechanics mesh sensing",
            "simulation": "batch warmup",
            "scene": "editing",
            "control": "inverse observer",
            "lab": "identification learning meshing study",
            "base": "arrays errors units values",
        }.items()
        for name in names.split()
    },
    "softsim_core.scene.attachment": "softsim_core.scene.deformable",
    "softsim_core.scene.material_region": "softsim_core.scene.deformable",
    "softsim_core.scene.objects": "softsim_core.scene.description",
    "softsim_core.scene.reinforcement": "softsim_core.scene.rod",
    "softsim_core.scene.solver_settings": "softsim_core.scene.description",
}
"""New names of modules, and of packages with all that is in them, that had another name before 0.2.0."""

keep_former_names(MOVED)

_HOME = {name: module for module, names in _NAMES.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value  # the next time it is found without this function
    return value


def __dir__() -> list[str]:
    return list(__all__)
