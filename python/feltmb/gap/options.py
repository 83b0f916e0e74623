"""Options of a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from feltmb.arguments import checked
from feltmb.errors import InvalidParameter
from feltmb.gap.criteria import ALPHA, FORM, SURE

__all__ = ["Options"]


@checked
@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of a diagnosis. The defaults are suitable for most cases."""

    alpha: float = ALPHA
    """Family-wise rate of false alarms."""
    credibility: float = SURE
    """Posterior probability that a named effect needs, compared with the other causes of the
    library. Its odds are the gain that held-out records must show."""
    form: float = FORM
    """Relative error of the force that the law of an effect gives [1].

    No law is exact: the true friction has another dependence on speed, the true felt another
    hysteresis. The 95 % interval of the magnitude of a law (effects of the kinds "force" and
    "state") contains this share of the magnitude as a standard deviation, in addition to the
    uncertainty from the records. A residual whose amplitude is a tenth of this share of what the
    effects explain is no gap. 0: the laws are exact, so that such a residual is a gap."""
    segment: float | None = None
    """Length of segments [s]; None: the length of the model, else chosen from the data."""
    max_effects: int = 4
    """Largest number of effects in a set, 1 to 6."""
    width: int = 4
    """Number of sets that are refitted after each screening."""
    bootstrap: int = 12
    """Refits of simulated records for the null distribution; 0: asymptotic only."""
    restarts: int = 3
    """Largest number of other starts of a poor fit."""
    seed: int = 0
    """Seed of the other starts and of the simulated records."""
    resume: Path | None = None
    """Folder for finished fits; an interrupted diagnosis continues from them. Diagnoses with other
    records, models or options use subfolders of their own. The folder remains, with about 1 MB
    for each diagnosis; ``shutil.rmtree(report.fits)`` removes the fits of one."""
    good_enough: Mapping[str, float] = field(default_factory=dict)
    """Practical accuracy by output or by unit (``{"m": 2e-4}``) [SI]. It is added to the noise of
    these channels; a fit whose residual is below both together leaves no gap."""
    profile: bool = False
    """Whether the likelihood profile of the magnitude of each named effect is computed: the
    magnitude is fixed at six values beside the estimate, and everything else is fitted again. The
    95 % interval of the profile does not use the linear model of the fit."""
    advice: bool = True
    """Whether experiments are predicted that would separate confused effects."""

    def __post_init__(self) -> None:
        faults = []
        if not 0.0 < self.alpha < 0.5:
            faults.append(f"alpha = {self.alpha!r}, expected in (0, 0.5)")
        if not 0.5 <= self.credibility < 1.0:
            faults.append(f"credibility = {self.credibility!r}, expected in [0.5, 1)")
        if not 0.0 <= self.form <= 0.3:
            faults.append(f"form = {self.form!r}, expected in [0, 0.3]")
        if not 1 <= self.max_effects <= 6:
            faults.append(f"max_effects = {self.max_effects!r}, expected 1 to 6")
        for name, floor in self.good_enough.items():
            if not 0.0 < floor < np.inf:
                faults.append(f"good_enough of {name} = {floor!r}, expected > 0")
        if self.bootstrap < 0:
            faults.append(f"bootstrap = {self.bootstrap!r}, expected >= 0")
        if faults:
            raise InvalidParameter("options: " + "; ".join(faults))
