"""Derivatives of a stroke by parameters of mechanism and stroke, and by the start state.

One pass gives the derivatives of every output by all parameters: forward sensitivities are
integrated along the steps of the stroke, with one factorized matrix for all of them
(``docs/howto/find_sensitivities.md``).
"""

from __future__ import annotations

from feltmb.run.sensitivity.objects import Gradient, Segment, state_names
from feltmb.run.sensitivity.work import gradient, segments, state_at

__all__ = ["Gradient", "Segment", "gradient", "segments", "state_at", "state_names"]
