"""
Micromechanics of fiber networks.
"""

from __future__ import annotations

import collections.abc
import typing

import numpy
import numpy.typing

__all__: list[str] = [
    "BeadSpringNetwork",
    "BeadSpringParams",
    "CompressionLaw",
    "FiberStructure",
    "LawDescription",
    "LawParameter",
    "OrientationQuadrature",
    "UniaxialStructure",
    "affine_density",
    "carnaby_pan",
    "carnaby_pan_march",
    "compress_energy",
    "compute_uniaxial_structure",
    "contact_count_distribution",
    "contact_model_names",
    "contacts_per_volume",
    "critical_angle",
    "deform_directions",
    "engineering_moduli",
    "estimate_structure",
    "estimate_tensors",
    "free_length_survival",
    "granular_stress_path",
    "history_descriptions",
    "law_descriptions",
    "make_random_directions",
    "mean_free_length",
    "narter_compliance",
    "narter_stiffness",
    "run_history",
    "sliding_at_force",
    "sliding_at_pressure",
    "sliding_proportion",
    "sliding_resistance",
    "uniaxial_structure",
    "unloading_is_unique",
]

class UniaxialStructure:
    """
    Structural numbers after compression by R; dimensionless.
    """
    def __repr__(self) -> str: ...
    def density(
        self, cos_theta: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]
    ) -> numpy.typing.NDArray[numpy.float64]:
        """
        Omega(theta) on the half sphere [1/sr].
        """
    def mean_inverse_sine(
        self, cos_theta: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]
    ) -> numpy.typing.NDArray[numpy.float64]:
        """
        Theta(theta), eq. 3.9 [-].
        """
    def mean_sine(
        self, cos_theta: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]
    ) -> numpy.typing.NDArray[numpy.float64]:
        """
        J(theta), eq. 3.5 [-].
        """
    def obstruction(self) -> float:
        """
        Psi of Pan's model [-].
        """
    @property
    def K3(self) -> float:
        """
        mean |cos theta| [-]
        """
    @property
    def M3(self) -> float:
        """
        mean sin^2 theta [-]
        """
    @property
    def cos4(self) -> float:
        """
        mean cos^4 theta [-]
        """
    @property
    def e3(self) -> float:
        """
        <e3^4>_c [-]
        """
    @property
    def f(self) -> float:
        """
        mean |e x e'| [-]
        """
    @property
    def n3(self) -> float:
        """
        <n3^4>_c [-]
        """
    @property
    def ratio(self) -> float:
        """
        R = v_f / v_random [-]
        """
    @property
    def sine(self) -> float:
        """
        mean sin theta [-]
        """

class FiberStructure:
    """
    Averages over a general orientation; dimensionless.
    """
    def __repr__(self) -> str: ...
    @property
    def K3(self) -> float: ...
    @property
    def M3(self) -> float: ...
    @property
    def e3(self) -> float: ...
    @property
    def ee(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[3, 3]"]: ...
    @property
    def eeee(self) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def eeee_contact(self) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def f(self) -> float: ...
    @property
    def n3(self) -> float: ...
    @property
    def nnnn_contact(self) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def obstruction(self) -> float: ...
    @property
    def tttt_contact(self) -> numpy.typing.NDArray[numpy.float64]: ...

class OrientationQuadrature:
    def __init__(
        self,
        n_polar: typing.SupportsInt | typing.SupportsIndex,
        n_azimuth: typing.SupportsInt | typing.SupportsIndex,
        n_circle: typing.SupportsInt | typing.SupportsIndex,
        obstruction: bool = False,
    ) -> None: ...
    def compute(
        self, density: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]
    ) -> FiberStructure: ...
    def directions(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 3]"]: ...
    def norm(self, density: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]) -> float: ...
    def size(self) -> int: ...

class LawParameter:
    """
    Description of one parameter of a law.
    """
    @property
    def default(self) -> float: ...
    @property
    def fit_high(self) -> float: ...
    @property
    def fit_low(self) -> float: ...
    @property
    def high(self) -> float: ...
    @property
    def log_scale(self) -> bool: ...
    @property
    def low(self) -> float: ...
    @property
    def low_open(self) -> bool: ...
    @property
    def meaning(self) -> str: ...
    @property
    def name(self) -> str: ...
    @property
    def unit(self) -> str: ...

class LawDescription:
    """
    Name, source and parameters of a law.
    """
    @property
    def name(self) -> str: ...
    @property
    def parameters(self) -> list[LawParameter]: ...
    @property
    def source(self) -> str: ...
    @property
    def title(self) -> str: ...
    @property
    def validity(self) -> str: ...

class CompressionLaw:
    """
    A compression law with its parameters; immutable.
    """

    __hash__: typing.ClassVar[None] = None
    def __eq__(self, arg0: CompressionLaw) -> bool: ...
    def __getstate__(self) -> tuple[int, str, dict[str, float]]: ...
    def __init__(
        self,
        name: str,
        parameters: collections.abc.Mapping[str, typing.SupportsFloat | typing.SupportsIndex],
    ) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def energy(
        self,
        v_f: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
        threads: typing.SupportsInt | typing.SupportsIndex = 0,
    ) -> numpy.typing.NDArray[numpy.float64]:
        """
        Stored energy per volume of fiber [J/m^3].
        """
    def pressure(
        self,
        v_f: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
        threads: typing.SupportsInt | typing.SupportsIndex = 0,
    ) -> numpy.typing.NDArray[numpy.float64]:
        """
        P [Pa], compression positive.
        """
    def slope(
        self,
        v_f: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
        threads: typing.SupportsInt | typing.SupportsIndex = 0,
    ) -> numpy.typing.NDArray[numpy.float64]:
        """
        dP/dv_f [Pa].
        """
    def volume_fraction(
        self,
        pressure: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
        v_max: typing.SupportsFloat | typing.SupportsIndex,
    ) -> numpy.typing.NDArray[numpy.float64]:
        """
        v_f at given pressure [-].
        """
    @property
    def limit(self) -> float:
        """
        v_f must stay below this [-]; inf if nothing jams.
        """
    @property
    def name(self) -> str: ...
    @property
    def parameters(self) -> dict[str, float]: ...
    @property
    def v_f0(self) -> float:
        """
        Fraction of zero pressure [-].
        """

class BeadSpringParams:
    """
    Fibers, material and numerics; SI units.
    """
    def __init__(
        self,
        *,
        n_fibers: typing.SupportsInt | typing.SupportsIndex,
        n_beads: typing.SupportsInt | typing.SupportsIndex,
        d_f: typing.SupportsFloat | typing.SupportsIndex,
        segment_length: typing.SupportsFloat | typing.SupportsIndex,
        v_f: typing.SupportsFloat | typing.SupportsIndex,
        crimp: typing.SupportsFloat | typing.SupportsIndex,
        ratio: typing.SupportsFloat | typing.SupportsIndex,
        seed: typing.SupportsInt | typing.SupportsIndex,
        E: typing.SupportsFloat | typing.SupportsIndex,
        density: typing.SupportsFloat | typing.SupportsIndex,
        repulsion: str,
        interaction: typing.SupportsFloat | typing.SupportsIndex,
        friction: typing.SupportsFloat | typing.SupportsIndex,
        tangential: typing.SupportsFloat | typing.SupportsIndex,
        drag: typing.SupportsFloat | typing.SupportsIndex,
        time_step: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...

class BeadSpringNetwork:
    """
    A periodic box of bead-spring fibers.
    """
    @typing.overload
    def __init__(
        self, params: BeadSpringParams, threads: typing.SupportsInt | typing.SupportsIndex = 0
    ) -> None: ...
    @typing.overload
    def __init__(
        self,
        params: BeadSpringParams,
        state: dict,
        threads: typing.SupportsInt | typing.SupportsIndex = 0,
    ) -> None: ...
    def advance(
        self,
        steps: typing.SupportsInt | typing.SupportsIndex,
        strain_per_step: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...
    def crossings(self) -> int: ...
    def densest(self) -> float: ...
    def directions(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 3]"]: ...
    def energy_and_forces(self) -> tuple[float, numpy.typing.NDArray[numpy.float64]]: ...
    def free_lengths(self) -> numpy.typing.NDArray[numpy.float64]: ...
    def relax(self, steps: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    def sample(self) -> dict: ...
    def state(self) -> dict: ...

def affine_density(
    deformation: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 3]"],
    directions: typing.Annotated[
        numpy.typing.NDArray[numpy.float64], "[m, 3]", "flags.c_contiguous"
    ],
) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]: ...
def carnaby_pan(
    v_f: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
    mu: typing.SupportsFloat | typing.SupportsIndex,
    Wf0: typing.SupportsFloat | typing.SupportsIndex,
    E: typing.SupportsFloat | typing.SupportsIndex,
    d_f: typing.SupportsFloat | typing.SupportsIndex,
    v_f0: typing.SupportsFloat | typing.SupportsIndex,
    gamma: typing.SupportsFloat | typing.SupportsIndex,
    k_bend: typing.SupportsFloat | typing.SupportsIndex,
    Q: typing.SupportsFloat | typing.SupportsIndex,
    form: str,
) -> dict: ...
def carnaby_pan_march(
    C: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
    mu: typing.SupportsFloat | typing.SupportsIndex,
    Wf0: typing.SupportsFloat | typing.SupportsIndex,
    E: typing.SupportsFloat | typing.SupportsIndex,
    d_f: typing.SupportsFloat | typing.SupportsIndex,
    v_f0: typing.SupportsFloat | typing.SupportsIndex,
    gamma: typing.SupportsFloat | typing.SupportsIndex,
    k_bend: typing.SupportsFloat | typing.SupportsIndex,
    Q: typing.SupportsFloat | typing.SupportsIndex,
    form: str,
    substeps: typing.SupportsInt | typing.SupportsIndex,
) -> dict: ...
def compress_energy(
    scheme: str,
    strain: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
    *,
    E: typing.SupportsFloat | typing.SupportsIndex,
    v_f0: typing.SupportsFloat | typing.SupportsIndex,
    chord_ratio: typing.SupportsFloat | typing.SupportsIndex,
    ratio: typing.SupportsFloat | typing.SupportsIndex,
    length_shape: typing.SupportsFloat | typing.SupportsIndex,
    slip_stress: typing.SupportsFloat | typing.SupportsIndex,
) -> numpy.typing.NDArray[numpy.float64]: ...
def compute_uniaxial_structure(
    ratio: typing.SupportsFloat | typing.SupportsIndex,
) -> UniaxialStructure: ...
def contact_count_distribution(
    model: str,
    k_max: typing.SupportsInt | typing.SupportsIndex,
    *,
    v_f: typing.SupportsFloat | typing.SupportsIndex,
    d_f: typing.SupportsFloat | typing.SupportsIndex,
    fiber_length: typing.SupportsFloat | typing.SupportsIndex,
    ratio: typing.SupportsFloat | typing.SupportsIndex,
    length_cv: typing.SupportsFloat | typing.SupportsIndex,
    gamma: typing.SupportsFloat | typing.SupportsIndex,
) -> numpy.typing.NDArray[numpy.float64]: ...
def contact_model_names() -> list[str]: ...
def contacts_per_volume(
    model: str,
    v_f: typing.SupportsFloat | typing.SupportsIndex,
    d_f: typing.SupportsFloat | typing.SupportsIndex,
    *,
    f: typing.SupportsFloat | typing.SupportsIndex,
    sine: typing.SupportsFloat | typing.SupportsIndex,
    obstruction: typing.SupportsFloat | typing.SupportsIndex,
    gamma: typing.SupportsFloat | typing.SupportsIndex,
    Q: typing.SupportsFloat | typing.SupportsIndex,
    diameter_cv: typing.SupportsFloat | typing.SupportsIndex,
    as_printed: bool,
    counting: str,
) -> float: ...
def critical_angle(
    w: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
    mu: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
) -> typing.Any: ...
def deform_directions(
    directions: typing.Annotated[
        numpy.typing.NDArray[numpy.float64], "[m, 3]", "flags.c_contiguous"
    ],
    deformation: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 3]"],
) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 3]"]: ...
def engineering_moduli(
    compliance: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[6, 6]"],
) -> tuple[
    typing.Annotated[list[float], "FixedSize(3)"],
    typing.Annotated[list[float], "FixedSize(3)"],
    typing.Annotated[list[float], "FixedSize(6)"],
]: ...
def estimate_structure(
    directions: typing.Annotated[
        numpy.typing.NDArray[numpy.float64], "[m, 3]", "flags.c_contiguous"
    ],
    threads: typing.SupportsInt | typing.SupportsIndex = 0,
) -> dict: ...
def estimate_tensors(
    directions: typing.Annotated[
        numpy.typing.NDArray[numpy.float64], "[m, 3]", "flags.c_contiguous"
    ],
    threads: typing.SupportsInt | typing.SupportsIndex = 0,
) -> FiberStructure: ...
def free_length_survival(
    model: str,
    x: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
    *,
    v_f: typing.SupportsFloat | typing.SupportsIndex,
    d_f: typing.SupportsFloat | typing.SupportsIndex,
    fiber_length: typing.SupportsFloat | typing.SupportsIndex,
    ratio: typing.SupportsFloat | typing.SupportsIndex,
    gamma: typing.SupportsFloat | typing.SupportsIndex,
) -> numpy.typing.NDArray[numpy.float64]: ...
def granular_stress_path(
    path: collections.abc.Sequence[
        typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 3]"]
    ],
    v_random: typing.SupportsFloat | typing.SupportsIndex,
    *,
    E: typing.SupportsFloat | typing.SupportsIndex,
    k_b: typing.SupportsFloat | typing.SupportsIndex,
    k_t: typing.SupportsFloat | typing.SupportsIndex,
    beta: typing.SupportsFloat | typing.SupportsIndex,
    transverse: bool,
    substeps: typing.SupportsInt | typing.SupportsIndex,
    nodes: typing.SupportsInt | typing.SupportsIndex,
) -> numpy.typing.NDArray[numpy.float64]: ...
def history_descriptions() -> list[LawDescription]: ...
def law_descriptions() -> list[LawDescription]: ...
def make_random_directions(
    n: typing.SupportsInt | typing.SupportsIndex,
    seed: typing.SupportsInt | typing.SupportsIndex,
    spread: typing.SupportsInt | typing.SupportsIndex,
    threads: typing.SupportsInt | typing.SupportsIndex = 0,
) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 3]"]: ...
def mean_free_length(
    model: str,
    v_f: typing.SupportsFloat | typing.SupportsIndex,
    d_f: typing.SupportsFloat | typing.SupportsIndex,
    *,
    f: typing.SupportsFloat | typing.SupportsIndex,
    sine: typing.SupportsFloat | typing.SupportsIndex,
    obstruction: typing.SupportsFloat | typing.SupportsIndex,
    gamma: typing.SupportsFloat | typing.SupportsIndex,
    Q: typing.SupportsFloat | typing.SupportsIndex,
    diameter_cv: typing.SupportsFloat | typing.SupportsIndex,
    as_printed: bool,
) -> float: ...
def narter_compliance(
    stiffness: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[6, 6]"],
) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[6, 6]"]: ...
def narter_stiffness(
    eeee: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
    stiffness: typing.SupportsFloat | typing.SupportsIndex,
) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[6, 6]"]: ...
def run_history(
    name: str,
    parameters: collections.abc.Mapping[
        str, collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex]
    ],
    spring: CompressionLaw,
    time: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
    x: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
    rate: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
) -> numpy.typing.NDArray[numpy.float64]: ...
def sliding_at_force(
    v_f: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
    C: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
    mu: typing.SupportsFloat | typing.SupportsIndex,
    Wf0: typing.SupportsFloat | typing.SupportsIndex,
    d_f: typing.SupportsFloat | typing.SupportsIndex,
    v_f0: typing.SupportsFloat | typing.SupportsIndex,
    gamma: typing.SupportsFloat | typing.SupportsIndex,
    Q: typing.SupportsFloat | typing.SupportsIndex,
) -> numpy.typing.NDArray[numpy.float64]: ...
def sliding_at_pressure(
    v_f: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
    pressure: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
    kind: str,
    mu: typing.SupportsFloat | typing.SupportsIndex,
    Wf0: typing.SupportsFloat | typing.SupportsIndex,
    d_f: typing.SupportsFloat | typing.SupportsIndex,
    v_f0: typing.SupportsFloat | typing.SupportsIndex,
    gamma: typing.SupportsFloat | typing.SupportsIndex,
    Q: typing.SupportsFloat | typing.SupportsIndex,
) -> numpy.typing.NDArray[numpy.float64]: ...
def sliding_proportion(
    ratio: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
    theta: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
) -> typing.Any: ...
def sliding_resistance(
    ratio: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
    mu: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
    theta: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
) -> typing.Any: ...
def uniaxial_structure(ratio: typing.SupportsFloat | typing.SupportsIndex) -> UniaxialStructure: ...
def unloading_is_unique(
    ratio: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
    mu: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
) -> typing.Any: ...
