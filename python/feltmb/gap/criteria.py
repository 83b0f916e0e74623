"""Every number that decides in a diagnosis: its value, unit, reason, data and test, in one place.

Numerics of a solver (steps, lengths, numbers of trials) stand where they are used. ``CRITERIA``
lists all in the order of the file; ``docs/reference/gap-criteria.md`` shows the same table.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["CRITERIA", "Criterion", "table"]


@dataclass(frozen=True)
class Criterion:
    """A number that decides."""

    name: str
    value: float | tuple[float, ...]
    unit: str
    reason: str
    data: str
    """What it was set on."""
    test: str
    """Test that holds it, below ``tests/python``."""


CRITERIA: list[Criterion] = []

#: Where a number follows from statistics, needs no data.
_STATISTICS = "none: it follows from statistics"
#: Where no measurement of the value was kept.
_JUDGED = "judgement; no measurement was kept"
_SEED_24 = "development half of seed 20261124, 306 blind cases"


def _number(name: str, value: float, unit: str, reason: str, data: str, test: str) -> float:
    CRITERIA.append(Criterion(name, value, unit, reason, data, test))
    return value


def _pair(
    name: str, value: tuple[float, float], unit: str, reason: str, data: str, test: str
) -> tuple[float, float]:
    CRITERIA.append(Criterion(name, value, unit, reason, data, test))
    return value


# ---------------------------------------------------------------- units

ANY_FACTOR = _number(
    "ANY_FACTOR", 0.5, "share of the value",
    "prior standard deviation from which a parameter may be any factor: units are not judged",
    _JUDGED, "gap/test_overlay.py",
)  # fmt: skip
ALIKE = _number(
    "ALIKE", 0.9, "correlation",
    "of record and model, from which a factor is that of a unit and nothing else", _JUDGED,
    "gap/test_overlay.py",
)  # fmt: skip

SEEN_GAP = _number(
    "SEEN_GAP", 3.0, "noise",
    "rms of record minus model from which a shift or a factor is asked for",
    _JUDGED, "gap/test_overlay.py",
)  # fmt: skip
NEAR_UNIT = _number(
    "NEAR_UNIT", 0.1, "1",
    "relative distance of a factor from that of a known unit", _JUDGED, "gap/test_overlay.py",
)  # fmt: skip
SAME_DELAY = _number(
    "SAME_DELAY", 0.3, "share of the mean",
    "spread of the delays of all channels that are told as one of the clock",
    _JUDGED, "gap/test_overlay.py",
)  # fmt: skip

# ---------------------------------------------------------------- is there a gap

MISFIT_RATIO = _number(
    "MISFIT_RATIO", 1.33**2, "1",
    "sum of squares over its expectation beyond which there is an unexplained residual; a noise "
    "that was estimated is wrong by up to a third",
    _JUDGED, "gap/test_rules.py",
)  # fmt: skip
EXCESS = _number(
    "EXCESS", 4.0, "sd",
    "standardized excess of the sum of squares that is a gap whatever causes it (p = 3e-5)",
    _STATISTICS, "gap/test_rules.py",
)  # fmt: skip
OTHER_EVIDENCE = _number(
    "OTHER_EVIDENCE", 6.0, "log evidence",
    "unknown forces or signals that are a gap whatever causes them: odds of 400",
    _STATISTICS, "gap/test_smooth.py",
)  # fmt: skip
FORM = _number(
    "FORM", 0.003, "1",
    "amplitude of what is left, over that of what the named effects explain, which may be an error "
    "of their form",
    _JUDGED, "gap/test_smooth.py",
)  # fmt: skip
REFUTED = _number(
    "REFUTED", 1e-4, "1",
    "family-wise p of the largest score at which the model is refuted, whatever held-out records "
    "say of the effect that has it",
    _STATISTICS, "gap/test_rules.py",
)  # fmt: skip
HINT = _number(
    "HINT", 5.0, "alpha",
    "family-wise p, in levels of false alarm, up to which records are too weak rather than without "
    "a gap",
    _JUDGED, "gap/test_rules.py",
)  # fmt: skip
NO_GAP_RATIO = _number(
    "NO_GAP_RATIO", 1.1, "noise",
    "gap below which the share of it that is closed says nothing, and factor by which a gap must "
    "grow to count as wider",
    _JUDGED, "gap/test_rules.py",
)  # fmt: skip

CELL_LEVEL = _number(
    "CELL_LEVEL", 0.05, "rate",
    "of false discoveries among the cells of channel and time", _STATISTICS, "gap/test_diagnose.py",
)  # fmt: skip
PLACE_LEVEL = _number(
    "PLACE_LEVEL", 0.01, "rate",
    "the same among events, and among components", _STATISTICS, "gap/test_diagnose.py",
)  # fmt: skip
ONSET_EXCESS = _number(
    "ONSET_EXCESS", 4.0, "sd",
    "of the running sum of squares, from which a gap has begun",
    _STATISTICS, "gap/test_diagnose.py",
)  # fmt: skip
CLOSE_ALARM = _number(
    "CLOSE_ALARM", 6.0, "threshold",
    "largest score, in thresholds of false alarm, up to which the threshold is calibrated by "
    "simulated records",
    _JUDGED, "gap/test_diagnose.py",
)  # fmt: skip

# ---------------------------------------------------------------- the noise and the rest

AS_TOLD = _number(
    "AS_TOLD", 1.15, "noise of the sensor",
    "size of the rest up to which it may be that noise", _JUDGED, "gap/test_smooth.py",
)  # fmt: skip
TOLD_SIGMA = _number(
    "TOLD_SIGMA", 0.2, "share of the sigma",
    "standard deviation of a sigma that is told: it is estimated with the rest", _JUDGED,
    "gap/test_told_sigma.py",
)  # fmt: skip
COLORED = _number(
    "COLORED", 0.2, "correlation",
    "of neighbors, from which the color of the rest is asked", _JUDGED, "gap/test_smooth.py",
)  # fmt: skip
STILL_SHRINKS = _number(
    "STILL_SHRINKS", 0.85, "1",
    "ratio of the rest to that of the round before from which it has stopped to shrink",
    _JUDGED, "gap/test_diagnose.py",
)  # fmt: skip
SLOW_COLOR = _number(
    "SLOW_COLOR", 0.3, "1",
    "frequency times correlation time of the noise up to which cosines are asked: above it one "
    "number of a data sheet does not say what the noise is",
    _JUDGED, "gap/test_smooth.py",
)  # fmt: skip
AT_REST = _pair(
    "AT_REST", (0.4, 1.4), "noise",
    "residual of a block of samples at rest", _JUDGED, "gap/test_color.py",
)  # fmt: skip
LEAST_BLOCKS = _number(
    "LEAST_BLOCKS", 5, "blocks", "needed to tell a color", _JUDGED, "gap/test_color.py",
)  # fmt: skip
COLOR_GAIN = _number(
    "COLOR_GAIN", 10.0, "log likelihood",
    "by which another color must beat that of the data sheet", _JUDGED, "gap/test_color.py",
)  # fmt: skip
SAME_SPREAD = _number(
    "SAME_SPREAD", 1.3, "1",
    "ratio within which the standard deviation of the blocks must be that of the sensor",
    _JUDGED, "gap/test_color.py",
)  # fmt: skip

# ---------------------------------------------------------------- data checks

COARSE = _number(
    "COARSE", 0.2, "share of the variance",
    "that may come from the digitizer where the color of the noise is looked for: the rounding of "
    "a slow motion is a sawtooth",
    _JUDGED, "gap/test_data.py",
)  # fmt: skip
CLOCK_JUMP = _number(
    "CLOCK_JUMP", 20.0, "median step",
    "of a clock, from which it is a data problem", _JUDGED, "gap/test_data.py",
)  # fmt: skip
UNEVEN_STEP = _pair(
    "UNEVEN_STEP", (0.5, 1.5), "median step",
    "range of the steps of an even clock", _JUDGED, "gap/test_data.py",
)  # fmt: skip
SAME_CLOCK = _number(
    "SAME_CLOCK", 0.001, "1",
    "relative difference of the steps of repeats that are compared", _JUDGED, "gap/test_data.py",
)  # fmt: skip
STANDS_STILL = _number(
    "STANDS_STILL", 0.1, "share of the steps",
    "that are zero, from which a digitizer is looked for", _JUDGED, "gap/test_data.py",
)  # fmt: skip
WHOLE_STEPS = _pair(
    "WHOLE_STEPS", (0.02, 0.95), "step, share",
    "distance from a whole number of smallest steps, and share of the steps within it, of a "
    "digitizer",
    _JUDGED, "gap/test_data.py",
)  # fmt: skip
FINE_DIGITS = _number(
    "FINE_DIGITS", 0.01, "spread",
    "step of a digitizer below which equal extremes are the end of the range",
    _JUDGED, "gap/test_data.py",
)  # fmt: skip
AWAY_FROM_REST = _number(
    "AWAY_FROM_REST", 0.5, "spread",
    "distance of an extreme from the median, from which it is not rest",
    _JUDGED, "gap/test_data.py",
)  # fmt: skip
QUIET_BLOCKS = _number(
    "QUIET_BLOCKS", 0.5, "1",
    "ratio of the noise of the quietest tenth to that of the middle, below which the rest of the "
    "record is motion",
    _JUDGED, "gap/test_data.py",
)  # fmt: skip
MOST_MISSING = _number(
    "MOST_MISSING", 0.5, "share of the values", "missing, from which it is told",
    _JUDGED, "gap/test_data.py",
)  # fmt: skip
MOST_CLIPPED = _number(
    "MOST_CLIPPED", 0.02, "share of the values", "at the end of the range, from which it is told",
    _JUDGED, "gap/test_data.py",
)  # fmt: skip
TOLD_SHARE = _number(
    "TOLD_SHARE", 0.5, "share of the squared gap",
    "that a shift or a factor must take away to be told", _JUDGED, "gap/test_overlay.py",
)  # fmt: skip

# ---------------------------------------------------------------- which effects are searched

LEAST_SURVIVING = _number(
    "LEAST_SURVIVING", 1e-7, "share of the signature",
    "that must survive the projection to be tested at all", _JUDGED, "gap/test_search.py",
)  # fmt: skip
FAINT_SCORE = _number(
    "FAINT_SCORE", 4.0, "T", "score below which an effect alone is not refitted",
    _JUDGED, "gap/test_search.py",
)  # fmt: skip
PROMISE = _number(
    "PROMISE", -3.0, "log evidence",
    "linear, below which a set is not refitted where the model explains the records",
    _JUDGED, "gap/test_search.py",
)  # fmt: skip
SMALL_GAIN = _number(
    "SMALL_GAIN", 0.02, "share of the evidence gained",
    "below which a further effect ends the search: it would not be told from an error in the form "
    "of a larger one",
    _JUDGED, "gap/test_search.py",
)  # fmt: skip
SHORT = _number(
    "SHORT", 1.0, "log evidence",
    "by which a fit may fall short of what a larger set predicts before it is made again",
    _JUDGED, "gap/test_search.py",
)  # fmt: skip
DEPENDENT = _number(
    "DEPENDENT", 0.0001, "1",
    "smallest eigenvalue of the correlations of signatures, below which a set is not told apart",
    _JUDGED, "gap/test_search.py",
)  # fmt: skip
BEYOND_PRIORS = _number(
    "BEYOND_PRIORS", 4.0, "sd",
    "of the sum of squared prior deviations, from which a fit is begun again from its priors",
    _STATISTICS, "gap/test_search.py",
)  # fmt: skip
NEAR_SHAPE = _number(
    "NEAR_SHAPE", 0.5, "share of the best gain",
    "from which the shape of a single effect is fitted", _JUDGED, "gap/test_shape.py",
)  # fmt: skip
NEAR_BEST = _number(
    "NEAR_BEST", 50.0, "log evidence",
    "below the best set, from which another set is no rival of it",
    _JUDGED, "gap/test_search.py",
)  # fmt: skip
SWAP_CORRELATION = _number(
    "SWAP_CORRELATION", 0.7, "correlation",
    "of traces from which an effect is tried in the place of another", _JUDGED,
    "gap/test_search.py",
)  # fmt: skip
FITTED_SHAPE = _number(
    "FITTED_SHAPE", 3.0, "log evidence",
    "that a fitted number of a shape costs: known to a twentieth of its range",
    _STATISTICS, "gap/test_shape.py",
)  # fmt: skip
WORTH_SHAPE = _number(
    "WORTH_SHAPE", 2.0, "log evidence",
    "that another shape must promise beyond what it costs", _JUDGED, "gap/test_shape.py",
)  # fmt: skip
LOOSE = _number(
    "LOOSE", 0.1, "spread of the states",
    "continuity defects that let parameters come back from their priors", _JUDGED,
    "gap/test_search.py",
)  # fmt: skip
DOUBT = _number(
    "DOUBT", 3.0, "log evidence",
    "that tight continuity may cost before the fit is tried from another start", _JUDGED,
    "gap/test_search.py",
)  # fmt: skip

# ---------------------------------------------------------------- which effects are accepted

LEAST_GAIN = _number(
    "LEAST_GAIN", math.log(10.0), "log predictive density",
    "gain that held-out records must show: ten to one", _STATISTICS, "gap/test_proof.py",
)  # fmt: skip
PAIRED_P = _number(
    "PAIRED_P", 0.4, "1",
    "p of the gain over held-out segments where the noise model holds: the gain alone decides",
    _JUDGED, "gap/test_proof.py",
)  # fmt: skip
PAIRED_P_INFLATED = _number(
    "PAIRED_P_INFLATED", 0.05, "1", "the same where the noise model is doubtful",
    _STATISTICS, "gap/test_proof.py",
)  # fmt: skip
INFLATED = _number(
    "INFLATED", 1.3, "noise", "inflation from which the noise model is doubtful",
    _JUDGED, "gap/test_proof.py",
)  # fmt: skip
WALD = _number(
    "WALD", 3.0, "sd",
    "by which a magnitude must differ from zero, or the score of the effect alone",
    _STATISTICS, "gap/test_rules.py",
)  # fmt: skip
CLOSES = _number(
    "CLOSES", 0.05, "share of the remaining held-out gap",
    "that makes more than small print of an effect where an unexplained residual was admitted",
    _JUDGED, "gap/test_rules.py",
)  # fmt: skip
CLOSES_ALL = _number(
    "CLOSES_ALL", 0.99, "share of the remaining held-out gap",
    "from which an effect is always significant: an effect that does not exist cannot compensate "
    "the error of form of another effect to 1 %",
    _JUDGED, "gap/test_rules.py",
)  # fmt: skip
DEEP_GAP = _number(
    "DEEP_GAP", 10.0, "noise", "gap that it must then close", _JUDGED, "gap/test_rules.py",
)  # fmt: skip
EXPLAINS_MOST = _number(
    "EXPLAINS_MOST", 0.5, "share of the squared held-out gap",
    "from which an effect stands though an unknown force would bring more: it explains more than "
    "is left",
    _JUDGED, "gap/test_rules.py",
)  # fmt: skip
WIDE_GAP = _number(
    "WIDE_GAP", 1.33, "noise",
    "held-out gap from which such a share counts, and it is asked whether parameters of the model "
    "could close it",
    _JUDGED, "gap/test_rules.py",
)  # fmt: skip
TOLERATED = _number(
    "TOLERATED", 4.0, "prior sd",
    "that a parameter may take up: of fifty parameters one goes beyond in one machine of 300",
    _STATISTICS, "adapters/test_aliases.py",
)  # fmt: skip

# ---------------------------------------------------------------- the verdict

NO_EFFECT = _number(
    "NO_EFFECT", 0.5, "probability",
    "prior that nothing is missing", _JUDGED, "gap/test_rules.py",
)  # fmt: skip
NOT_LISTED = _number(
    "NOT_LISTED", 0.1, "probability",
    "prior that something is missing which no effect of the library is",
    _JUDGED, "gap/test_rules.py",
)  # fmt: skip
RIVAL = _number(
    "RIVAL", math.log(20.0), "log evidence",
    "below the best set, up to which another may be a rival: odds of twenty",
    _STATISTICS, "gap/test_rules.py",
)  # fmt: skip
SURE = _number(
    "SURE", 0.9, "probability", "posterior that a name needs", _JUDGED, "gap/test_rules.py",
)  # fmt: skip
LEAST_CLOSED = _number(
    "LEAST_CLOSED", 0.2, "share of the held-out gap",
    "that a name must close where an unexplained residual was admitted", _JUDGED,
    "gap/test_rules.py",
)  # fmt: skip
REST_EXCESS = _number(
    "REST_EXCESS", 3.0, "sd",
    "excess of the sum of squares for what is left after effects were named",
    _STATISTICS, "gap/test_rules.py",
)  # fmt: skip
TRUST_NAMED = _number(
    "TRUST_NAMED", 0.97, "share of the cases",
    "in which the first of the ranking was right, of what its evidence promised: evidence cannot "
    "see what is not in the library. Of the verdict NAMED",
    _SEED_24, "gap/test_rules.py",
)  # fmt: skip
TRUST_DATA = _number(
    "TRUST_DATA", 0.98, "share of the cases", "the same of DATA PROBLEM", _SEED_24,
    "gap/test_rules.py",
)  # fmt: skip
TRUST_REST = _number(
    "TRUST_REST", 0.72, "share of the cases", "the same of NAMED, RESIDUAL REMAINS", _SEED_24,
    "gap/test_rules.py",
)  # fmt: skip
TRUST_ONE_OF = _number(
    "TRUST_ONE_OF", 0.5, "share of the cases", "the same of ONE OF", _SEED_24, "gap/test_rules.py",
)  # fmt: skip
TRUST_WEAK = _number(
    "TRUST_WEAK", 0.6, "share of the cases", "the same of TOO WEAK", _SEED_24, "gap/test_rules.py",
)  # fmt: skip
TRUST_UNKNOWN = _number(
    "TRUST_UNKNOWN", 0.36, "share of the cases", "the same of UNKNOWN", _SEED_24,
    "gap/test_rules.py",
)  # fmt: skip

# ---------------------------------------------------------------- what is told beside it

LARGE_MOVE = _number(
    "LARGE_MOVE", 0.1, "share of the gap",
    "from which a parameter that moved is told in the statement beside others", _JUDGED,
    "gap/test_rules.py",
)  # fmt: skip
MOVED = _number(
    "MOVED", 2.0, "posterior sd",
    "from its tabulated value, from which a parameter was moved", _STATISTICS,
    "adapters/test_aliases.py",
)  # fmt: skip
FAR_FROM_PRIOR = _number(
    "FAR_FROM_PRIOR", 2.0, "prior sd", "from which a part is to be measured by itself", _JUDGED,
    "gap/test_report_order.py",
)  # fmt: skip
SIGNATURE = _number(
    "SIGNATURE", 0.15, "share of a recovered force",
    "from which it is said what it looks like", _JUDGED, "gap/test_diagnose.py",
)  # fmt: skip
SECOND_SIGNATURE = _number(
    "SECOND_SIGNATURE", 0.7, "share of the largest share",
    "from which another form is told beside it", _JUDGED, "gap/test_diagnose.py",
)  # fmt: skip
ONSET_SHARE = _number(
    "ONSET_SHARE", 0.1, "share of noise and of the largest",
    "difference of an output at which an effect shows", _JUDGED, "gap/test_diagnose.py",
)  # fmt: skip

# ---------------------------------------------------------------- plans and advice

DETECTABLE = _number(
    "DETECTABLE", 3.7, "noncentrality",
    "seen in nine of ten records at one false alarm in a hundred", _STATISTICS,
    "gap/test_planning.py",
)  # fmt: skip
CLEAR_SIGNAL = _number(
    "CLEAR_SIGNAL", 5.0, "signal-to-noise ratio", "from which an effect counts as detectable",
    _JUDGED, "gap/test_withhold.py",
)  # fmt: skip
POOR_EXPERIMENT = _number(
    "POOR_EXPERIMENT", 0.2, "confusion", "above which an experiment is not worth the name",
    _JUDGED, "gap/test_experiments.py",
)  # fmt: skip
CLEAR_DIFFERENCE = _number(
    "CLEAR_DIFFERENCE", 0.005, "confusion", "below which noise is not what hides a difference",
    _JUDGED, "gap/test_experiments.py",
)  # fmt: skip
CONFUSED = _number(
    "CONFUSED", 0.1, "probability",
    "of taking one effect for another, from which they are one class",
    _JUDGED, "gap/test_planning.py",
)  # fmt: skip
SEPARATES = _number(
    "SEPARATES", 0.95, "1",
    "ratio of the confusion after an experiment to that before, above which it does not help",
    _JUDGED, "gap/test_experiments.py",
)  # fmt: skip
TOLD_GAIN = _pair(
    "TOLD_GAIN", (0.05, 0.02), "probability",
    "confusion of a pair, and what an experiment must take from it, to be told",
    _JUDGED, "gap/test_planning.py",
)  # fmt: skip
BETTER_SENSOR = _number(
    "BETTER_SENSOR", 3.0, "1",
    "factor by which the noise of the sensor that is proposed is lower",
    _JUDGED, "gap/test_experiments.py",
)  # fmt: skip


def table() -> str:
    """The criteria as a table in Markdown."""
    lines = ["| name | value | unit | reason | set on | test |", "|---|---|---|---|---|---|"]
    for c in CRITERIA:
        values = c.value if isinstance(c.value, tuple) else (c.value,)
        shown = ", ".join(f"{v:.4g}" for v in values)
        lines.append(f"| `{c.name}` | {shown} | {c.unit} | {c.reason} | {c.data} | `{c.test}` |")
    return "\n".join(lines) + "\n"
