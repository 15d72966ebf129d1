from .cache import be_silent as be_silent
from .compiler import (
    Compiler as Compiler,
    OneSignature as OneSignature,
    why_plain as why_plain,
)
from .dispatchers import get_ready_to_load as get_ready_to_load
from .worker import (
    CompileProcess as CompileProcess,
    KernelRequest as KernelRequest,
    alone as alone,
    compile_process as compile_process,
)
