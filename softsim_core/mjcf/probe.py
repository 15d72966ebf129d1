"""A first look at a model, alone in a process: `python .../probe.py FILE`; it imports nothing of this suite.

MuJoCo's parsers read meshes and XML in C. A crash on a damaged file ends only this process.
"""

from __future__ import annotations

import sys

MEMORY = 4 << 30
"""Memory limit of the process in bytes."""
PROCESSOR_S = 60
"""Limit of processor time in [s]."""
REFUSED = 3
"""Exit code after an error of MuJoCo; its message is on standard output."""


def main(words: list[str]) -> int:
    """Load and compile a model, and compute all positions."""
    import mujoco

    try:
        import resource
    except ImportError:  # no POSIX system: the caller's time limit must suffice
        pass
    else:
        resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
        resource.setrlimit(resource.RLIMIT_CPU, (PROCESSOR_S, PROCESSOR_S))
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        model = mujoco.MjSpec.from_file(words[0]).compile()
        mujoco.mj_forward(model, mujoco.MjData(model))
    except Exception as error:
        sys.stdout.write(" ".join(str(error).split())[:300])
        return REFUSED
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
