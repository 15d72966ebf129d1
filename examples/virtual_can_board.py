"""Drive the board of my_can_board.py without hardware, on a virtual bus of python-can."""

import threading
import time
from pathlib import Path

from my_can_board import NUMBER, POSE, CanPort

from servo_bridge.driver import ServoDriver
from softsim_core import load_scene

BUS = "can:virtual:bus"


def run_board(bus: str, poses: list[bytes], ended: threading.Event, number: int = 7) -> None:
    port = CanPort(bus)
    while not ended.is_set():
        port.write(NUMBER + bytes([number]))
        due = time.monotonic() + 0.1
        while time.monotonic() < due:
            if (frame := port.read())[:2] == POSE:
                poses.append(frame[2:])
    port.close()


if __name__ == "__main__":
    driver, poses, ended = (
        ServoDriver(load_scene(Path(__file__).with_name("my_can_board.py"))),
        [b""],
        threading.Event(),
    )
    threading.Thread(target=run_board, args=(BUS, poses, ended)).start()
    driver.connect(BUS, quiet_s=1.0)
    while poses[-1] != bytes((121, 99)):
        driver.command([-1.0, -1.39])
        driver.tick()
        time.sleep(driver.period)
    print(f"{driver.link_state}: {len(poses) - 1} frames, servos at {tuple(poses[-1])} degrees")
    driver.disconnect()
    ended.set()
