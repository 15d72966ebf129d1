from .doctor import (
    Finding as Finding,
    Level as Level,
)
from .suite import (
    UncoveredPathError as UncoveredPathError,
    coverage_table as coverage_table,
    covering_tests as covering_tests,
    files_of as files_of,
)
