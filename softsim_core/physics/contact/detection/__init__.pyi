from .detector import (
    Closeness as Closeness,
    Detector as Detector,
    Proximities as Proximities,
    measured_gaps as measured_gaps,
)
