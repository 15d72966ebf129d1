"""The clamped body as a deformable body of Drake: linear corotated tetrahedra, discrete steps.

Drake prescribes boundary conditions on half spaces only. A box of nodes is therefore clamped by Drake's fixed
constraint, which its contact solver resolves in every step. The same body falling freely shows what a step
costs without that constraint.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from benchmarks.peers.body import ClampedBody, PeerMissingError
from softsim_core.base import Array, install_command, version_of
from softsim_core.physics.mesh import TetMesh, write_tets


class DrakeBody:
    """The clamped body as a deformable body of Drake.

    Args:
        body: What to simulate.
        clamped: Whether the nodes in the box are clamped; False lets the body fall.

    Raises:
        PeerMissingError: Drake is not installed.
    """

    def __init__(self, body: ClampedBody, clamped: bool = True) -> None:
        try:
            from pydrake import geometry, math
            from pydrake.multibody import fem, plant
            from pydrake.systems.analysis import Simulator
            from pydrake.systems.framework import DiagramBuilder
        except ImportError as error:
            raise PeerMissingError(
                f"Drake is not measured ({error}): {install_command('peers')} (x86-64 Linux)"
            ) from error
        self.version = version_of("drake") or ""
        self.name = "drake" if clamped else "drake_falling"
        self.method = f"linear corotated, {'SAP with fixed constraints' if clamped else 'nothing clamped'}"
        self.rests = clamped
        self._dt, self._steps, self._rest = body.dt, 0, body.points.T.copy()
        builder = DiagramBuilder()
        world, _ = plant.AddMultibodyPlant(
            plant.MultibodyPlantConfig(time_step=body.dt, discrete_contact_approximation="lagged"), builder
        )
        material = fem.DeformableBodyConfig()
        material.set_material_model(fem.MaterialModel.kLinearCorotated)
        material.set_youngs_modulus(body.young_modulus)
        material.set_poissons_ratio(body.poisson_ratio)
        material.set_mass_density(body.total_mass / body.volume)
        material.set_mass_damping_coefficient(0.0)
        material.set_stiffness_damping_coefficient(0.0)
        nowhere = math.RigidTransform()
        self._model = world.mutable_deformable_model()
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "body.vtk"
            write_tets(file, TetMesh(body.points, body.tets, "body"))
            shape = geometry.GeometryInstance(nowhere, geometry.Mesh(str(file), 1.0), "body")
            shape.set_proximity_properties(geometry.ProximityProperties())
            self._body = self._model.RegisterDeformableBody(shape, material, 1.0)
        center = math.RigidTransform(np.array(body.box.center))
        if clamped:
            self._model.AddFixedConstraint(
                self._body, world.world_body(), nowhere, geometry.Box(*body.box.size), center
            )
        world.mutable_gravity_field().set_gravity_vector(body.gravity)
        world.Finalize()
        self._simulator = Simulator(builder.Build())
        self._context = world.GetMyContextFromRoot(self._simulator.get_mutable_context())
        self._simulator.Initialize()

    def restart(self) -> None:
        """Return to the rest shape with zero velocity."""
        self._model.SetPositionsAndVelocities(
            self._context, self._body, self._rest, np.zeros_like(self._rest)
        )

    def advance(self) -> None:
        """Advance by one step of dt."""
        self._steps += 1
        self._simulator.AdvanceTo(self._steps * self._dt)

    def points(self) -> Array:
        """Return the current node positions in [m], shape (n, 3), in the order of ClampedBody.points."""
        return np.asarray(self._model.GetPositions(self._context, self._body)).T.copy()
