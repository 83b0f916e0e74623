"""Orientation of the fibers, and structural numbers that follow from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from feltmb._core import fiber as _core
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter

Array = NDArray[np.float64]


@checked
def structure(ratio: float) -> _core.UniaxialStructure:
    """Exact structural numbers of a network compressed uniaxially from a random state.

    Parameters
    ----------
    ratio
        R = v_f / v_random [-]: 1 is isotropic, large values are planar, values below 1 are
        stretched; 1e-3 to 1e6.

    Returns
    -------
    UniaxialStructure
        ``f`` (mean sine of the angle between fibers), ``n3`` and ``e3`` (fourth moments
        ``<n3^4>_c``, ``<e3^4>_c`` of contact normals and axes), ``K3`` (mean abs cos theta),
        ``M3`` (mean sin^2 theta), ``cos4``, ``sine``; methods ``density(cos_theta)``
        [1/sr, half sphere], ``mean_sine``, ``mean_inverse_sine``, ``obstruction()``.

    Raises
    ------
    InvalidParameter
        The ratio is out of range.

    Examples
    --------
    Mean sine of the angle between two fibers, pressed to half and without a preferred direction:

    >>> from feltmb import fiber
    >>> round(fiber.structure(2.0).f, 4), round(fiber.structure(1.0).f, 4)
    (0.7566, 0.7854)
    """
    return _core.compute_uniaxial_structure(float(ratio))


@checked
def uniaxial_tensor(ratio: float) -> Array:
    """Fourth-order tensor <e e e e> over the fibers after uniaxial compression by R, exact.

    Parameters
    ----------
    ratio
        R = v_f / v_random [-], as in :func:`structure`.

    Returns
    -------
    ndarray
        Shape (3, 3, 3, 3) [-], isotropic about axis 3.

    Examples
    --------
    Averages of the fourth power of a component, and of two squares, without a preference:

    >>> from feltmb import fiber
    >>> tensor = fiber.uniaxial_tensor(1.0)
    >>> round(float(tensor[0, 0, 0, 0]), 6), round(float(tensor[0, 0, 1, 1]), 6)
    (0.2, 0.066667)
    """
    s = structure(ratio)
    c2, c4 = 1.0 - s.M3, s.cos4
    mixed = 0.5 * (c2 - c4)
    flat = (1.0 - 2.0 * c2 + c4) / 8.0
    by_exponents = {
        (4, 0): 3 * flat,
        (2, 2): flat,
        (0, 4): 3 * flat,
        (2, 0): mixed,
        (0, 2): mixed,
        (0, 0): c4,
    }
    tensor = np.zeros((3, 3, 3, 3))
    for index in np.ndindex(3, 3, 3, 3):
        tensor[index] = by_exponents.get((index.count(0), index.count(1)), 0.0)
    return tensor


@dataclass(frozen=True)
class NetworkEstimate:
    """Structural numbers of a sampled network, each with its standard error."""

    f: float
    n3: float
    e3: float
    K3: float
    M3: float
    error: dict[str, float]
    """Standard errors by name; upper bounds if diffusion steps were used (``spread``)."""


@dataclass(frozen=True)
class Network:
    """Directions of the fibers of a random network."""

    directions: Array
    """Unit vectors [-], shape (n, 3), read-only."""
    seed: int
    spread: int
    """Number of diffusion steps after the rejection sampling."""
    deformation: Array
    """Deformation gradient since the random state [-], shape (3, 3)."""

    @checked
    def deform(self, deformation: ArrayLike) -> Network:
        """Rotate every fiber affinely (eq. 3.46).

        Parameters
        ----------
        deformation
            Deformation gradient F, shape (3, 3), det F > 0; or one number R for uniaxial
            compression along axis 3, F = diag(1, 1, 1/R) (eq. 3.57).
        """
        given = np.asarray(deformation, dtype=float)
        if given.ndim == 0:
            if not given > 0:
                raise InvalidParameter(f"network: ratio = {float(given):.6g}, must be > 0")
            given = np.diag([1.0, 1.0, 1.0 / float(given)])
        if given.shape != (3, 3):
            raise InvalidParameter(
                f"network: deformation has shape {given.shape}, expected (3, 3) or one number"
            )
        moved = _core.deform_directions(self.directions, given)
        moved.flags.writeable = False
        return Network(moved, self.seed, self.spread, given @ self.deformation)

    @checked
    def structure(self, threads: int = 0) -> NetworkEstimate:
        """Estimate f, n3, e3, K3, M3 with their sampling errors (all pairs of fibers)."""
        values = _core.estimate_structure(self.directions, threads)
        return NetworkEstimate(
            **{name: value for name, (value, _) in values.items()},
            error={name: error for name, (_, error) in values.items()},
        )

    @checked
    def tensors(self, threads: int = 0) -> _core.FiberStructure:
        """Complete second and fourth-order structure tensors, by sums over all pairs."""
        return _core.estimate_tensors(self.directions, threads)


@checked
def network(n: int, seed: int = 0, spread: int = 30, threads: int = 0) -> Network:
    """Make a random isotropic network (thesis 3.1.3).

    Points are uniform in a cube; points outside the unit ball are rejected, and the others are
    projected on the sphere. Then ``spread`` diffusion steps increase the angles between neighboring
    axes.

    Parameters
    ----------
    n
        Number of fibers, 2 to 1 000 000 (the thesis uses 6000).
    seed
        Equal seeds give equal networks for every number of threads.
    spread
        Number of diffusion steps; with 0, the fibers are statistically independent.
    threads
        Number of threads; 0: all cores.

    Examples
    --------
    Directions of 100 fibers, pressed to half:

    >>> import numpy as np
    >>> from feltmb import fiber
    >>> pressed = fiber.network(100).deform(np.diag([1.0, 1.0, 0.5]))
    >>> pressed.directions.shape
    (100, 3)
    """
    if n < 2 or seed < 0 or spread < 0:
        raise InvalidParameter(
            f"network: n = {n}, seed = {seed}, spread = {spread}; "
            "expected n >= 2, seed >= 0, spread >= 0"
        )
    directions = _core.make_random_directions(int(n), int(seed), int(spread), int(threads))
    directions.flags.writeable = False
    return Network(directions, int(seed), int(spread), np.eye(3))


Density = Callable[[Array, Array], ArrayLike]


@checked
def density_structure(
    density: Density | None = None,
    *,
    deformation: ArrayLike | None = None,
    tolerance: float = 1e-9,
    obstruction: bool = False,
    max_nodes: int = 96,
) -> _core.FiberStructure:
    """Structure of any orientation density, with complete fourth-order tensors.

    Parameters
    ----------
    density
        Function of polar angle theta and azimuth phi (arrays [rad], theta in [0, pi], phi in [0,
        pi]) that returns Omega or any multiple of it; the function normalizes it.
    deformation
        Replaces ``density``: F of an initially isotropic network, shape (3, 3).
    tolerance
        Nodes are added until f, n3 and e3 change by less than this.
    obstruction
        Whether Psi of Pan's contact model is computed, which needs many more points.
    max_nodes
        Largest number of polar nodes.

    Returns
    -------
    FiberStructure
        ``f, n3, e3, K3, M3, ee, eeee, nnnn_contact, eeee_contact, tttt_contact, obstruction``.

    Raises
    ------
    InvalidParameter
        The density is negative or not finite, or ``max_nodes`` are not sufficient.

    Examples
    --------
    The mean sine of :func:`structure`, from the deformation:

    >>> import numpy as np
    >>> from feltmb import fiber
    >>> flat = fiber.density_structure(deformation=np.diag([1.0, 1.0, 0.5]), tolerance=1e-6)
    >>> round(flat.f, 4), round(fiber.structure(2.0).f, 4)
    (0.7566, 0.7566)
    """
    if (density is None) == (deformation is None):
        raise InvalidParameter("orientation: give either density or deformation, and not both")
    if deformation is not None and np.shape(deformation) != (3, 3):
        raise InvalidParameter(
            f"orientation: deformation has shape {np.shape(deformation)}, expected (3, 3)"
        )
    previous: Any = None
    nodes = 12
    change = float("inf")
    while nodes <= max_nodes:
        quadrature = _core.OrientationQuadrature(nodes, 2 * nodes, 2 * nodes, obstruction)
        directions = quadrature.directions()
        if density is None:
            values = _core.affine_density(np.asarray(deformation, dtype=float), directions)
        else:
            # Axes have no direction: they are mapped to phi in [0, pi].
            folded = np.where(directions[:, 1:2] < 0, -directions, directions)
            theta = np.arccos(np.clip(folded[:, 2], -1.0, 1.0))
            phi = np.arctan2(folded[:, 1], folded[:, 0])
            values = np.broadcast_to(np.asarray(density(theta, phi), dtype=float), theta.shape)
        result = quadrature.compute(np.ascontiguousarray(values))
        if previous is not None:
            change = max(abs(getattr(result, k) - getattr(previous, k)) for k in ("f", "n3", "e3"))
            if change < tolerance:
                return result
        previous = result
        nodes = nodes * 3 // 2
    raise InvalidParameter(
        f"orientation: f, n3 or e3 still changes by {change:.3g} with {nodes * 2 // 3} polar "
        f"nodes, must be below {tolerance:.3g} (raise max_nodes or tolerance; a density with "
        "jumps or a very sharp peak is not resolved)"
    )


@dataclass(frozen=True)
class NarterTensors:
    """Linear elasticity of a bonded network (Narter). Components: 11, 22, 33, 12, 13, 23."""

    stiffness: Array
    """Stiffness matrix [Pa], shape (6, 6)."""
    compliance: Array
    """Compliance matrix [1/Pa], shape (6, 6)."""
    young: tuple[float, float, float]
    """Young's moduli E1, E2, E3 [Pa]."""
    shear: tuple[float, float, float]
    """Shear moduli G12, G13, G23 [Pa]."""
    poisson: dict[str, float]
    """Poisson's ratios nu12, nu13, nu21, nu23, nu31, nu32 [-]."""


@checked
def narter_tensors(eeee: ArrayLike, E: float, v_f: float) -> NarterTensors:
    """Stiffness, compliance and engineering moduli of Narter's axial model (eqs. 3.16-3.25).

    Parameters
    ----------
    eeee
        Fourth-order orientation tensor over fibers, shape (3, 3, 3, 3), for example
        ``uniaxial_tensor(ratio)``, ``density_structure(...).eeee`` or
        ``network(...).tensors().eeee``.
    E
        Fiber modulus [Pa].
    v_f
        Fiber volume fraction [-]; K = E v_f.

    Examples
    --------
    Young's moduli [Pa] of a bonded network of wool, 10 % of fibers:

    >>> from feltmb import fiber
    >>> found = fiber.narter_tensors(fiber.uniaxial_tensor(1.0), 2.5e9, 0.1)
    >>> [round(float(v) / 1e6, 1) for v in found.young]
    [41.7, 41.7, 41.7]
    """
    if not (E > 0 and 0 < v_f < 1):
        raise InvalidParameter(
            f"narter: E = {E:.6g} Pa, v_f = {v_f:.6g}, expected E > 0 and 0 < v_f < 1"
        )
    stiffness = _core.narter_stiffness(np.asarray(eeee, dtype=float), float(E) * float(v_f))
    compliance = _core.narter_compliance(stiffness)
    young, shear, poisson = _core.engineering_moduli(compliance)
    names = ["nu12", "nu13", "nu21", "nu23", "nu31", "nu32"]
    return NarterTensors(
        stiffness,
        compliance,
        (young[0], young[1], young[2]),
        (shear[0], shear[1], shear[2]),
        dict(zip(names, poisson, strict=True)),
    )
