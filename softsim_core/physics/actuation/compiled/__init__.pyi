from .kinds import (
    CompiledKinds as CompiledKinds,
    compiled_kinds as compiled_kinds,
    compiler as compiler,
    fill as fill,
    measure as measure,
)
