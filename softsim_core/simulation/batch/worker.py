"""Worker process of a batch: `python -m softsim_core.simulation.batch.worker SOCKET MEMORY` (descriptors).

It answers calls on its Share until the other side of the socket closes.
"""

from __future__ import annotations

import mmap
import signal
import sys
from multiprocessing.connection import Connection

import numpy as np

from softsim_core.simulation.batch.batch import Share, failure


def serve(calls: Connection, memory: int) -> None:
    """Answer calls; `memory` is the file descriptor of the states."""
    robot, backend, shape, first, count = calls.recv()
    states = np.frombuffer(mmap.mmap(memory, 8 * shape[0] * shape[1]), dtype=float).reshape(shape)
    share: Share | None = None
    while True:
        try:
            if share is None:
                share = Share(robot, backend)
                share.fill(states[first : first + count])
                answer = None
            else:
                name, arguments = calls.recv()
                answer = getattr(share, name)(*arguments)
            calls.send((True, answer))
        except (EOFError, ConnectionError):
            return
        except Exception as error:  # any error is returned to the caller
            calls.send((False, failure(error)))
            if share is None:
                return


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the caller, and with it the socket
    serve(Connection(int(sys.argv[1])), int(sys.argv[2]))
