"""Micromechanics of fiber networks: structure, contacts, compression laws, fits, simulation.

All numbers are in SI units; volume fractions, strains and structural numbers are dimensionless.
Compression and pressure are positive. See ``docs/explanation/fiber.md``.
"""

from feltmb.fiber.contacts import (
    ContactCount,
    contact_count,
    contacts_per_volume,
    free_length_survival,
    mean_free_length,
)
from feltmb.fiber.data import CompressionData, read_compression
from feltmb.fiber.energy_method import EnergyCurve, compress_arcs
from feltmb.fiber.fitting import Fit, compare, fit, fit_branches
from feltmb.fiber.friction import (
    CarnabyPan,
    carnaby_pan,
    carnaby_pan_march,
    critical_angle,
)
from feltmb.fiber.granular import granular_stress
from feltmb.fiber.histories import history, history_models
from feltmb.fiber.laws import law, models, pressure
from feltmb.fiber.orientation import (
    Network,
    NetworkEstimate,
    density_structure,
    narter_tensors,
    network,
    structure,
    uniaxial_tensor,
)
from feltmb.fiber.ranges import unusual
from feltmb.fiber.simulation import Cycle, FiberBox, FiberRun, lay, read_directions, simulate

__all__ = [
    "CarnabyPan",
    "CompressionData",
    "ContactCount",
    "Cycle",
    "EnergyCurve",
    "FiberBox",
    "FiberRun",
    "Fit",
    "Network",
    "NetworkEstimate",
    "carnaby_pan",
    "carnaby_pan_march",
    "compare",
    "compress_arcs",
    "contact_count",
    "contacts_per_volume",
    "critical_angle",
    "density_structure",
    "fit",
    "fit_branches",
    "free_length_survival",
    "granular_stress",
    "history",
    "history_models",
    "law",
    "lay",
    "mean_free_length",
    "models",
    "narter_tensors",
    "network",
    "pressure",
    "read_compression",
    "read_directions",
    "simulate",
    "structure",
    "uniaxial_tensor",
    "unusual",
]
