"""Models of simulations that can be fitted: parameters with priors, effects, and derivatives."""

from feltmb.fit.coordinates import Coordinate, Coupling, Rate
from feltmb.fit.coordinates import Named as Named
from feltmb.fit.equations import Equations
from feltmb.fit.fmi import fmu
from feltmb.fit.inclusion import Including as Including
from feltmb.fit.inclusion import including
from feltmb.fit.mjcf import mujoco
from feltmb.fit.model import Candidate as Candidate
from feltmb.fit.model import Effect, Model, Parameter, State
from feltmb.fit.model import EffectKind as EffectKind
from feltmb.fit.model import Jobs as Jobs
from feltmb.fit.model import Port as Port
from feltmb.fit.model import Ready as Ready
from feltmb.fit.model import Sensitivity as Sensitivity
from feltmb.fit.model import SensitivityRequest as SensitivityRequest
from feltmb.fit.priors import Exposed
from feltmb.fit.simulator import FunctionModel, LinearModel, Simulator

# The other names are for authors of models: feltmb.fit.authoring.
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
