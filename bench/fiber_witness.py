"""Pressure of a laid network without friction: feltmb against FiberMat (F. Mahe, MIT license).

    python bench/fiber_witness.py lay FILE.npz [SEED]      in an environment with fibermat, pandas<3
    python bench/fiber_witness.py compress FILE.npz        in one with feltmb

`lay` stacks straight fibers and compresses them between plates with FiberMat: beams of linear
theory whose points move vertically, hard contacts. `compress` takes the same stack: the energy of
feltmb's bead-spring fibers between the same plates is minimized, each fiber in its own vertical
plane. The table is in docs/validation/felt_tests.md. Lengths are in diameters, pressures in E.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

FIBERS, LENGTH, SIDE, SEGMENT = 60, 30.0, 40.0, 2.0
PACKINGS = (1.75, 2.0, 2.25, 2.5, 2.75, 3.0, 3.5, 4.0)
#: Of FiberMat's factor of the coupling of deflection and rotation; 0.99 is its default, 1 is the
#: beam, for which its matrix is singular.
COUPLINGS = (0.99, 1.0 - 1e-7)


def lay(file: str, seed: int) -> None:
    """Stack and compress with FiberMat; write the stack and the pressures."""
    from fibermat import Mat, Mesh, Net, Stack, solve
    from fibermat.model.timoshenko import Timoshenko

    # Its beams have the bending stiffness pi/48 E b h^3, round ones pi/64; stiff in shear.
    mat = Mat(
        FIBERS, length=LENGTH, width=1.0, thickness=1.0, size=SIDE, shear=1e3, tensile=0.75,
        seed=seed,
    )  # fmt: skip
    stack = Stack(Net(mat))
    mat = stack.flags.mat
    found: dict[str, Any] = {key: np.array(mat[key], dtype=float) for key in "xyzuv"}
    t = np.linspace(0.0, 1.0, 1000)
    for coupling in COUPLINGS:
        model = Timoshenko(Mesh(stack), coupling=coupling)
        run = solve(model, packing=4.05, itermax=30_000, verbose=False)
        packing = np.array([float(run.rlambda(s)) for s in t])
        force = np.array([run.f(s)[2::3].sum() for s in t])
        found[f"P {coupling}"] = np.interp(PACKINGS, packing, force / SIDE**2)
        height = float(run.Z(0.0))
    np.savez(file, height=height, **found)


class Stacked:
    """The fibers of feltmb between plates; the displacements are along a fiber and vertical."""

    def __init__(self, found: Any):
        from feltmb.fiber import FiberBox, lay

        self.height = float(found["height"])
        self.beads = round(LENGTH / SEGMENT) + 1
        self.unit = 1e-3  # m
        self.box = FiberBox(
            n_fibers=FIBERS, n_beads=self.beads, d_f=self.unit, segment_length=SEGMENT * self.unit,
            v_f=0.03, crimp=0.0, E=1e6, friction=0.0,
        )  # fmt: skip
        network = lay(self.box, 1)
        self.make, self.state = type(network), network.state()
        for key in ("velocities", "rest_angles"):
            self.state[key] = np.zeros_like(self.state[key])
        # The box is so high that no image of a fiber touches.
        self.state["box"] = self.unit * np.array([SIDE, SIDE, 3.0 * self.height])
        center = np.column_stack([found[key] for key in "xyz"])
        self.along = np.column_stack([found["u"], found["v"], np.zeros(FIBERS)])[:, None]
        s = np.linspace(-0.5 * LENGTH, 0.5 * LENGTH, self.beads)[None, :, None]
        self.x = center[:, None] + s * self.along
        # Displacements are scaled by the stiffness of one fiber: the search needs fewer steps.
        self.scale = []
        for order, stiffness in ((1, np.pi / 4 / SEGMENT), (2, np.pi / 64 / SEGMENT**3)):
            d = np.diff(np.eye(self.beads), order, axis=0)
            matrix = stiffness * d.T @ d + 3e-3 * np.eye(self.beads)
            self.scale.append(np.linalg.inv(np.linalg.cholesky(matrix)))

    def energy(self, x: Any, top: float) -> tuple[float, Any, float]:
        """Energy [E d^3], forces [E d^2] and the force on the upper plate."""
        state = {**self.state, "positions": (x * self.unit).ravel()}
        energy, forces = self.make(self.box.core(), state, 1).energy_and_forces()
        unit = self.box.E * self.unit**2
        forces = np.reshape(forces, x.shape) / unit
        stiffness = 2.0  # of a plate: as stiff as a contact
        low = np.maximum(0.5 - x[..., 2], 0.0)
        high = np.maximum(x[..., 2] + 0.5 - top, 0.0)
        forces[..., 2] += stiffness * (low - high)
        plates = 0.5 * stiffness * float(np.sum(low**2) + np.sum(high**2))
        return energy / (unit * self.unit) + plates, forces, stiffness * float(np.sum(high))

    def compress(self, top: float, most: int) -> tuple[float, Any]:
        """Move the upper plate; return the pressure and what the search said."""
        from scipy.optimize import minimize

        base = self.x.copy()
        base[..., 2] = 0.5 + (base[..., 2] - 0.5) * (top - 1.0) / (self.top - 1.0)

        def moved(q: Any) -> Any:
            q = q.reshape(FIBERS, 2, self.beads)
            x = base + (q[:, 0] @ self.scale[0])[..., None] * self.along
            x[..., 2] += q[:, 1] @ self.scale[1]
            return x

        def goal(q: Any) -> tuple[float, Any]:
            energy, forces, _ = self.energy(moved(q), top)
            ahead = np.sum(forces * self.along, axis=2) @ self.scale[0].T
            slope = np.stack([ahead, forces[..., 2] @ self.scale[1].T], axis=1)
            return 1e4 * energy, -1e4 * slope.ravel()

        found = minimize(
            goal, np.zeros(2 * FIBERS * self.beads), jac=True, method="L-BFGS-B",
            options={"maxiter": most, "maxfun": 2 * most, "maxcor": 30, "ftol": 1e-14},
        )  # fmt: skip
        self.x, self.top = moved(found.x), top
        return self.energy(self.x, top)[2] / SIDE**2, found


def compress(file: str, most: int = 2500) -> None:
    """Compress the stack with feltmb; print the pressures of both."""
    found = np.load(file)
    stack = Stacked(found)
    stack.top = stack.height
    print("packing  P/E feltmb  FiberMat  ratio  FiberMat by default  steps")
    steps = (1.3, 1.5, *PACKINGS)
    for packing in steps:
        pressure, search = stack.compress(stack.height / packing, most)
        if packing in PACKINGS:
            default, beam = (float(found[f"P {c}"][PACKINGS.index(packing)]) for c in COUPLINGS)
            ratio = pressure / beam
            row = f"{packing:7.2f}  {pressure:.3e}  {beam:.3e}  {ratio:.2f}  {default:.3e}"
            print(row, search.nit, flush=True)


if __name__ == "__main__":
    if sys.argv[1] == "lay":
        lay(sys.argv[2], int(sys.argv[3]) if len(sys.argv) > 3 else 0)
    else:
        compress(sys.argv[2])
