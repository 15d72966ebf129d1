from .calibrate_report import (
    RequestedResults as RequestedResults,
    describe_endings as describe_endings,
    page as page,
    plain as plain,
    report_lines as report_lines,
)
from .validate_report import validation_page as validation_page
