"""The simulator's line in /diagnostics."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from softsim_ros.messages.diagnostics import ERROR, OK, WARN
from softsim_ros.simulator.physics_thread import PhysicsStatus

SLOW = 0.95
"""Below this share of the asked speed the simulator says that it is slow."""

NOT_LOADED: Final = "scene not loaded: "
"""How a fault begins whose cause is a file of the scene; the physics before it is whole."""


def memory_mb() -> float:
    """Resident memory of this process in [MB]; 0 where /proc does not tell."""
    try:
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmRSS:"):
                return float(line.split()[1]) / 1024.0
    except OSError:
        pass
    return 0.0


def health(status: PhysicsStatus, alive: bool, speed: float) -> tuple[bytes, str, dict[str, object]]:
    """Level, sentence and values of the diagnostics.

    Args:
        status: What the physics did lately.
        alive: Whether its thread runs.
        speed: Asked speed, simulated seconds a wall second; 0 is as fast as possible.
    """
    factor = status.speed.real_time_factor
    state = "paused" if status.paused else "running"
    level, sentence = OK, state
    if not alive:
        level, sentence, state = ERROR, "the physics thread has ended; restart the simulator", "ended"
    elif status.fault:
        level, sentence, state = ERROR, status.fault, "stopped"
    elif status.contacts is not None and status.contacts.unsolved:
        level, sentence = WARN, status.contacts.complaint
    elif status.inverted_elements:
        count = status.inverted_elements
        told = "element is" if count == 1 else "elements are"
        level, sentence = WARN, f"{count} {told} inside out; reduce dt, the load, or the pull on them"
    elif status.fallbacks:
        level, sentence = WARN, status.fallbacks.complaint
    elif not status.paused and 0.0 < factor < SLOW * speed:
        level, sentence = WARN, f"slower than asked: {factor:.2f} of {speed:g} times real time"
    values: dict[str, object] = {
        "state": state,
        "real_time_factor": factor,
        "steps_per_second": status.speed.steps_per_second,
        "steps": status.steps,
        "cpu_ms_per_step": status.speed.cpu_ms,
        "time_s": status.time_s,
        "dt_s": status.dt,
        "time_behind_s": status.late_s,
        "scene": "not loaded" if status.fault.startswith(NOT_LOADED) else "loaded",
        "trajectory": "running" if status.trajectory else "none",
        "clamped_commands": status.clamped_commands,
        "refused_commands": status.refused_commands,
        "backend": status.backend,
        "inverted_elements": status.inverted_elements,
        **status.fallbacks.as_values(),
        "memory_mb": memory_mb(),
    }
    if status.contacts is not None:
        values.update(status.contacts.as_values())
    for stage, time_ms in status.speed.stages_ms.items():
        values[f"{stage}_ms"] = time_ms
    return level, sentence, values
