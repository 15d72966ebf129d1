from .alignment import (
    Alignment as Alignment,
    align as align,
    locate_sensors as locate_sensors,
    rigid_frame as rigid_frame,
)
from .calibration import (
    CalibrationDescription as CalibrationDescription,
    Loss as Loss,
    ParameterDescription as ParameterDescription,
    data_of as data_of,
    first_calibration as first_calibration,
    known_calibrations as known_calibrations,
    load_calibration as load_calibration,
    write_calibration as write_calibration,
    write_description as write_description,
    write_table as write_table,
)
from .confidence import (
    DistributionDescription as DistributionDescription,
    Folds as Folds,
    cross_validated as cross_validated,
    distribution_of as distribution_of,
    load_distribution as load_distribution,
    profiled as profiled,
)
from .description import (
    EFFECTOR as EFFECTOR,
    AlignmentDescription as AlignmentDescription,
    CommandColumns as CommandColumns,
    DataFolder as DataFolder,
    DataSet as DataSet,
    DataSetDescription as DataSetDescription,
    ErrorLimits as ErrorLimits,
    FrameDescription as FrameDescription,
    ModelDescription as ModelDescription,
    OtherModel as OtherModel,
    PublishedError as PublishedError,
    SensorDescription as SensorDescription,
    SessionDescription as SessionDescription,
    SplitDescription as SplitDescription,
    TimeColumn as TimeColumn,
    known_data_sets as known_data_sets,
    load_data_set as load_data_set,
)
from .error_measures import (
    Measures as Measures,
    PointLoss as PointLoss,
    by_region as by_region,
    measures as measures,
)
from .excitation import (
    KINDS as KINDS,
    ExcitationSettings as ExcitationSettings,
    Motion as Motion,
    MotionLimits as MotionLimits,
    NextPoses as NextPoses,
    chirp as chirp,
    grid as grid,
    motion_limits_of as motion_limits_of,
    motions as motions,
    next_poses as next_poses,
    ring_down as ring_down,
    steps as steps,
    way as way,
)
from .expressions import (
    evaluate_expression as evaluate_expression,
    names_in as names_in,
    replace_expressions as replace_expressions,
)
from .fitting import (
    QUANTILE as QUANTILE,
    Calibration as Calibration,
    Ending as Ending,
    calibrate as calibrate,
    fit as fit,
)
from .league import (
    LeagueEntry as LeagueEntry,
    league_entries as league_entries,
    regression_errors as regression_errors,
)
from .model_replay import (
    SAME as SAME,
    Near as Near,
    Prediction as Prediction,
    in_short_steps as in_short_steps,
    release_errors as release_errors,
    replay as replay,
    ringing as ringing,
)
from .problem import Misfit as Misfit
from .session import (
    Session as Session,
    load_session as load_session,
)
from .spread import (
    neighbours as neighbours,
    widening as widening,
)
from .tables import (
    READERS as READERS,
    Table as Table,
    read_table as read_table,
)
from .validation import (
    SessionResult as SessionResult,
    compare_session as compare_session,
    given_alignment as given_alignment,
    plain as plain,
    read_alignments as read_alignments,
    session_robot as session_robot,
    summary as summary,
    validate_session as validate_session,
    worst as worst,
)
