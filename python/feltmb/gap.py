"""The diagnosis for owners of a mechanism: names of :mod:`unmodeled` that they need.

:func:`diagnose` finds what a mechanism lacks when it does not agree with measured strokes.
:func:`feltmb.adapters.mechanism_model` makes the model of a mechanism and its possible effects.
"""

from unmodeled import (
    Options,
    Record,
    Report,
    Sensor,
    Verdict,
    candidates,
    check,
    diagnose,
    fit_model,
    read,
    read_measured,
    with_measured,
    withhold,
)

__all__ = [
    "Options",
    "Record",
    "Report",
    "Sensor",
    "Verdict",
    "candidates",
    "check",
    "diagnose",
    "fit_model",
    "read",
    "read_measured",
    "with_measured",
    "withhold",
]
