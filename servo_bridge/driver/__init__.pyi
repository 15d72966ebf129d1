from .board_session import (
    DELAYS_S as DELAYS_S,
    BoardSession as BoardSession,
    Recovery as Recovery,
    RequestedState as RequestedState,
)
from .calibration import (
    START_TIMEOUT_S as START_TIMEOUT_S,
    CalibrationAbortedError as CalibrationAbortedError,
    ServoMover as ServoMover,
    ServoObservation as ServoObservation,
    apply_observation as apply_observation,
    calibrate as calibrate,
    calibrated_robot as calibrated_robot,
    default_file as default_file,
    file_for as file_for,
    load_calibration as load_calibration,
    save_calibration as save_calibration,
)
from .driver import (
    FASTEST_HZ as FASTEST_HZ,
    SLOWEST_HZ as SLOWEST_HZ,
    ServoDriver as ServoDriver,
)
from .link import (
    BoardLink as BoardLink,
    MetBoard as MetBoard,
    Reader as Reader,
)
from .ports import (
    BOARD_USB_IDS as BOARD_USB_IDS,
    CLONE_USB_IDS as CLONE_USB_IDS,
    SerialTransport as SerialTransport,
    find_port as find_port,
    find_same_device as find_same_device,
    open_transport as open_transport,
    opening_error_message as opening_error_message,
    register_transport as register_transport,
    stable_name as stable_name,
    usb_identity as usb_identity,
)
from .safety import (
    SERVO_ACCELERATION as SERVO_ACCELERATION,
    SERVO_SPEED as SERVO_SPEED,
    EStop as EStop,
    MotionSettings as MotionSettings,
    ServoMotion as ServoMotion,
    servo_limits as servo_limits,
)
from .servo import (
    PULSE_MIN_US as PULSE_MIN_US,
    PULSE_US_PER_180 as PULSE_US_PER_180,
    PULSES_PER_RAD as PULSES_PER_RAD,
    angle_to_byte as angle_to_byte,
    angle_to_pulse as angle_to_pulse,
    angle_to_width as angle_to_width,
    angles_to_bytes as angles_to_bytes,
    byte_to_angle as byte_to_angle,
    byte_to_width as byte_to_width,
    bytes_to_angles as bytes_to_angles,
    pulse_to_angle as pulse_to_angle,
    width_limits as width_limits,
    width_to_angle as width_to_angle,
    width_to_byte as width_to_byte,
    within as within,
)
from .takeover import STALL_S as STALL_S
from .writer import (
    HANG_S as HANG_S,
    HangDetector as HangDetector,
    PeriodicThread as PeriodicThread,
)
