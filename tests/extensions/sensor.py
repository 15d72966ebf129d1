"""The sensor of sensor.patch in a scene's file: sampled, and sent as a number on its topic."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from std_msgs.msg import Float64, Header

from softsim_core import Simulation
from softsim_core.scene import load_scene
from softsim_ros.messages import messages_of

FINGER = Path("configs", "scenes", "cable_finger.yaml").resolve()

with TemporaryDirectory() as folder:
    file = Path(folder, "felt.yaml")
    file.write_text(
        f"extends: {FINGER}\nname: felt\n"
        "sensors: [{name: lowest, kind: height, body: finger, noise: 0.001}]\n"
    )
    simulation = Simulation(load_scene(file))
simulation.step()
reading = simulation.sensors["lowest"]
(sent,) = messages_of(reading.description, 101_325.0)
message = sent.write(Header(), reading)
assert (sent.below, type(message)) == ("", Float64)
assert message.data == float(reading.value)
assert abs(message.data - simulation.positions[:, 2].min()) < 0.01
print("works")
