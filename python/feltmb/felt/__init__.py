"""Felt: materials, identification from tests, force-compression loops of contacts, audit of laws.

SI units; compression, pressure and contact force are positive in compression. See
``docs/explanation/felt.md``.
"""

from feltmb.contact.layer import CircleOnLayer, ConstantArea, CrossedCylinders, SphereOnLayer
from feltmb.felt.audit_checks import Cycle, Finding
from feltmb.felt.auditing import Audit, audit, audit_targets
from feltmb.felt.densities import bulk
from feltmb.felt.envelopes import (
    FeltEnvelope,
    envelope,
    load_envelope,
    parse_area,
)
from feltmb.felt.fitting import ContactFit, contact_loop, fit_contact
from feltmb.felt.identification import BranchFit, Identification, identify
from feltmb.felt.laws import LawFit, PooledLaw, fit_law, pool
from feltmb.felt.loop_uncertainty import LoopUncertainty
from feltmb.felt.measured import (
    MeasuredLoop,
    Specimen,
    measured_loop,
    read_measured_loop,
    read_specimen,
)
from feltmb.fiber.material import (
    Branch,
    BranchCurve,
    FeltMaterial,
    Fiber,
    load_material,
    packaged_materials,
)

__all__ = [
    "Audit",
    "Branch",
    "BranchCurve",
    "BranchFit",
    "CircleOnLayer",
    "ConstantArea",
    "ContactFit",
    "CrossedCylinders",
    "Cycle",
    "FeltEnvelope",
    "FeltMaterial",
    "Fiber",
    "Finding",
    "Identification",
    "LawFit",
    "LoopUncertainty",
    "MeasuredLoop",
    "PooledLaw",
    "Specimen",
    "SphereOnLayer",
    "audit",
    "audit_targets",
    "bulk",
    "contact_loop",
    "envelope",
    "fit_contact",
    "fit_law",
    "identify",
    "load_envelope",
    "load_material",
    "measured_loop",
    "packaged_materials",
    "parse_area",
    "pool",
    "read_measured_loop",
    "read_specimen",
]
