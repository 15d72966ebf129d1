from .doctor import (
    Finding as Finding,
    Level as Level,
)
from .suite import (
    TESTS as TESTS,
    UncoveredPathError as UncoveredPathError,
    covering_tests as covering_tests,
    covering_words as covering_words,
    files_of as files_of,
)
