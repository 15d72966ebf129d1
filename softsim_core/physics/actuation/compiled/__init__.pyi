from .compile import compiler as compiler
from .kinds import (
    CompiledKinds as CompiledKinds,
    compiled_kinds as compiled_kinds,
    fill as fill,
    measure as measure,
)
