"""An actuator of one's own: a stretchy tendon from a point of a body to a winch that stands in space.

Its coordinate s is by how much the way from the point to the winch has become shorter. The winch takes up q;
the tendon, of stiffness k, stretches by what is missing: its tension is t = k (q - s), a compliance of 1 / k.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

import softsim_core as soft
from softsim_core.base import Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class ElasticTendonDescription(soft.ActuatorDescription):  # its fields are the keys of a scene file
    kind: ClassVar[str] = "elastic_tendon"
    body: str
    point: Vector  # in [m]
    winch: Vector  # in [m]
    stiffness: float  # in [N/m]

    def bodies(self):  # so that a wrong name is refused when the scene is loaded
        return {"body": self.body}


class ElasticTendon(soft.Actuator):
    def __init__(self, placed, surroundings):
        tendon = placed.description
        bound = surroundings.bind(f"tendon {placed.name}", tendon.body, np.array([tendon.point]))
        super().__init__(placed.name, placed.joint, bound.nodes[0], compliance=1.0 / tendon.stiffness)
        self.weights, self.winch = bound.weights[0], np.array(tendon.winch)
        self.rest_length = np.linalg.norm(self.winch - tendon.point)

    def way(self, state):
        return self.winch - self.weights @ state.positions[self.place]

    def value(self, model, state):
        return self.rest_length - np.linalg.norm(self.way(state))

    def row(self, model, state):
        way = self.way(state)
        return np.outer(self.weights, way / np.linalg.norm(way))

    def bounds(self, command):
        return 0.0, np.inf  # it pulls, and hangs slack where it would have to push

    def geometric_stiffness(self, model, state, multiplier):
        return soft.line_stiffness(self.place, self.weights, self.way(state), multiplier)


soft.register_actuator(ElasticTendonDescription, ElasticTendon)


def create_scene(scene):
    bar = soft.box_mesh((0.1, 0.02, 0.02), (10, 2, 2), (0.0, -0.01, -0.01))
    rubber = soft.MaterialDescription(young_modulus=1e5, poisson_ratio=0.0)
    scene.gravity = (0.0, 0.0, 0.0)
    scene.add(soft.BodyDescription(name="bar", mesh=bar, material=rubber, total_mass=0.04))
    for name, to, x in (("wall", "world", 0.0), ("tip", "free", 0.1)):
        end = soft.Box(center=(x, 0.0, 0.0), size=(1e-4, 1.0, 1.0))
        scene.add(soft.AttachmentDescription(name=name, body="bar", to=to, box=end))
    tendon = ElasticTendonDescription(body="bar", point=(0.1, 0, 0), winch=(0.2, 0, 0), stiffness=500.0)
    scene.add(soft.JointDescription(name="winch", kind="elastic_tendon", actuator=tendon))


if __name__ == "__main__":
    simulation = soft.Simulation(soft.load_scene(Path(__file__)))
    state = simulation.equilibrium([0.01]).state  # the winch takes up 10 mm
    print(f"tip pulled by {1e3 * state.joint_positions[0]:.3f} mm, tension {state.joint_efforts[0]:.4f} N")
