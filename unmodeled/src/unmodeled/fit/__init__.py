"""Models of simulations that can be fitted: parameters with priors, effects, and derivatives."""

from unmodeled.fit.equations import Equations
from unmodeled.fit.fmi import fmu
from unmodeled.fit.inclusion import Including as Including
from unmodeled.fit.inclusion import including
from unmodeled.fit.mjcf import mujoco
from unmodeled.fit.priors import Exposed
from unmodeled.fit.simulator import FunctionModel, LinearModel, Simulator
from unmodeled.models.coordinates import Coordinate, Coupling, Rate
from unmodeled.models.coordinates import Named as Named
from unmodeled.models.model import Candidate as Candidate
from unmodeled.models.model import Effect, Model, Parameter, State
from unmodeled.models.model import EffectKind as EffectKind
from unmodeled.models.model import Jobs as Jobs
from unmodeled.models.model import Port as Port
from unmodeled.models.model import Ready as Ready
from unmodeled.models.model import Sensitivity as Sensitivity
from unmodeled.models.model import SensitivityRequest as SensitivityRequest

# The other names are for authors of models: unmodeled.models.
__all__ = [
    "Coordinate",
    "Coupling",
    "Effect",
    "Equations",
    "Exposed",
    "FunctionModel",
    "LinearModel",
    "Model",
    "Parameter",
    "Rate",
    "Simulator",
    "State",
    "fmu",
    "including",
    "mujoco",
]
