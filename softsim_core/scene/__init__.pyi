from .board import (
    BoardDescription as BoardDescription,
    BusServo as BusServo,
    Servo as Servo,
    ServoCalibration as ServoCalibration,
)
from .control import (
    KEY_NAMES as KEY_NAMES,
    Action as Action,
    CommandSettings as CommandSettings,
    InverseSettings as InverseSettings,
    KeyBinding as KeyBinding,
    StartAnimation as StartAnimation,
)
from .deformable import (
    AddedMassDescription as AddedMassDescription,
    AttachmentDescription as AttachmentDescription,
    BodyDescription as BodyDescription,
    MaterialRegionDescription as MaterialRegionDescription,
    nodes_in as nodes_in,
)
from .description import (
    CollisionDescription as CollisionDescription,
    Colour as Colour,
    RigidBodyDescription as RigidBodyDescription,
    RotationLaw as RotationLaw,
    SceneDescription as SceneDescription,
    SolverSettings as SolverSettings,
    Threads as Threads,
)
from .file_keys import (
    beside as beside,
    hints_of as hints_of,
    is_absent as is_absent,
    is_beside as is_beside,
    keys_of as keys_of,
)
from .io.catalog import SceneCatalog as SceneCatalog
from .io.files import (
    find_config as find_config,
    known_scenes as known_scenes,
)
from .io.loaders import (
    load_python as load_python,
    load_scene as load_scene,
    load_yaml as load_yaml,
)
from .joint import JointDescription as JointDescription
from .material import (
    DEFAULT_LAW as DEFAULT_LAW,
    MaterialDescription as MaterialDescription,
    law_parameters as law_parameters,
)
from .placement import (
    Motion as Motion,
    place_scene as place_scene,
)
from .robot import (
    Controller as Controller,
    RobotDescription as RobotDescription,
    RunningSimulation as RunningSimulation,
    as_robot as as_robot,
    need_namespace as need_namespace,
)
from .rod import (
    AxisDescription as AxisDescription,
    FibresDescription as FibresDescription,
    LayerDescription as LayerDescription,
    LayerOfRodDescription as LayerOfRodDescription,
    RodClampDescription as RodClampDescription,
    RodDescription as RodDescription,
    RodSectionDescription as RodSectionDescription,
)
from .scene import (
    Part as Part,
    Scene as Scene,
    animated as animated,
)
from .size import (
    check_size as check_size,
    scene_size as scene_size,
)
from .tendons import (
    Backbone as Backbone,
    Tendon as Tendon,
    TendonArmDescription as TendonArmDescription,
    TendonSegment as TendonSegment,
    tendon_arm as tendon_arm,
)
from .view import (
    LAYERS as LAYERS,
    STRESS_MAPS as STRESS_MAPS,
    Camera as Camera,
    Section as Section,
    StressMap as StressMap,
    ViewSettings as ViewSettings,
)
