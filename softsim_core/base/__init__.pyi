from .arrays import (
    Array as Array,
    BoolArray as BoolArray,
    IndexArray as IndexArray,
    float_array as float_array,
    unique_pairs as unique_pairs,
)
from .errors import (
    ArrayError as ArrayError,
    BatchError as BatchError,
    CommandError as CommandError,
    ConfigError as ConfigError,
    DataError as DataError,
    DetectionOverflowError as DetectionOverflowError,
    FactorisationError as FactorisationError,
    MaterialError as MaterialError,
    MeshError as MeshError,
    MjcfError as MjcfError,
    NotConvergedError as NotConvergedError,
    NotReachedError as NotReachedError,
    PolicyError as PolicyError,
    SceneError as SceneError,
    SnapshotError as SnapshotError,
    SoftSimError as SoftSimError,
    SolverDivergedError as SolverDivergedError,
    StudyError as StudyError,
    listing as listing,
)
from .extras import install_command as install_command
from .files import (
    LockError as LockError,
    RuntimeFolderError as RuntimeFolderError,
    make_folder as make_folder,
    open_in_place as open_in_place,
    open_lock as open_lock,
    put_in_place as put_in_place,
    refuse_links as refuse_links,
    runtime_folder as runtime_folder,
    sync as sync,
    sync_tree as sync_tree,
    write_file as write_file,
)
from .machine import (
    describe_machine as describe_machine,
    limit_threads as limit_threads,
    version_of as version_of,
)
from .moved import (
    FormerAttribute as FormerAttribute,
    FormerNames as FormerNames,
    find_former_names as find_former_names,
    keep_former_names as keep_former_names,
)
from .names import (
    MOST_PROPOSED as MOST_PROPOSED,
    Registry as Registry,
    did_you_mean as did_you_mean,
    known_names as known_names,
    nearest as nearest,
    one_of as one_of,
)
from .processes import (
    python_command as python_command,
    run_process as run_process,
    start_process as start_process,
    use_safe_path as use_safe_path,
)
from .timing import (
    Contender as Contender,
    no_garbage_collection as no_garbage_collection,
    restart_every as restart_every,
    take_turns as take_turns,
)
from .units import (
    ANGLE as ANGLE,
    FORCE as FORCE,
    LENGTH as LENGTH,
    MILLIMETRE as MILLIMETRE,
    PRESSURE as PRESSURE,
    SCALES as SCALES,
    SHORTENING as SHORTENING,
    VOLUME as VOLUME,
    JointUnits as JointUnits,
    Quantity as Quantity,
    Unit as Unit,
    degrees as degrees,
    radians as radians,
)
from .values import (
    DIRECTION as DIRECTION,
    LOCAL as LOCAL,
    POINT as POINT,
    Backend as Backend,
    Box as Box,
    FieldError as FieldError,
    MeshFile as MeshFile,
    Placement as Placement,
    SceneName as SceneName,
    Sphere as Sphere,
    Vector as Vector,
    need_finite as need_finite,
    need_positive as need_positive,
    need_unit as need_unit,
)
