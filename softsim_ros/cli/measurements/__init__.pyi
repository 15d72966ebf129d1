from .calibrate_page import page as page
from .calibrate_report import (
    RequestedResults as RequestedResults,
    plain as plain,
    sentences as sentences,
    told_of_endings as told_of_endings,
)
from .validate_report import (
    PAGE as PAGE,
    write as write,
)
