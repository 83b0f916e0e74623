"""All decision thresholds of a diagnosis: value, unit, reason, data and test.

Some limits follow from the numbers of the user, the rate of false alarms and the credibility:
``DERIVED``. The others are constants: ``CRITERIA``.

Numerical settings of solvers (steps, lengths, numbers of trials) are in the files that use them.
``CRITERIA`` lists them in the order of this file. ``docs/reference/gap-criteria.md`` shows the same
table.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from scipy import stats

__all__ = [
    "CRITERIA",
    "DERIVED",
    "Criterion",
    "Derived",
    "contradicted",
    "least_odds",
    "refuted",
    "squares_of_noise",
    "table",
    "unknown_gain",
]


@dataclass(frozen=True)
class Criterion:
    """A decision threshold."""

    name: str
    value: float | tuple[float, ...]
    unit: str
    reason: str
    data: str
    """Source of the value: data, or a statistical argument."""
    test: str
    """Test of the decision, below ``tests/python``."""


CRITERIA: list[Criterion] = []

#: The number follows from statistics and needs no data.
_STATISTICS = "none; the value follows from statistics"
#: No measurement that determined the value was stored.
_JUDGED = "judgment"


def _number(name: str, value: float, unit: str, reason: str, data: str, test: str) -> float:
    CRITERIA.append(Criterion(name, value, unit, reason, data, test))
    return value


def _pair(
    name: str, value: tuple[float, float], unit: str, reason: str, data: str, test: str
) -> tuple[float, float]:
    CRITERIA.append(Criterion(name, value, unit, reason, data, test))
    return value


# ---------------------------------------------------------------- limits from the user's numbers


def refuted(alpha: float) -> float:
    """Probability below which one test refutes the model, whatever other records say.

    It is the probability that two independent tests both alarm by chance.

    Parameters
    ----------
    alpha
        Rate of false alarms (``Options.alpha``).
    """
    return alpha**2


def squares_of_noise(alpha: float, dof: float) -> float:
    """Sum of squares above which a residual is more than noise: :func:`refuted` of chi2(dof).

    Parameters
    ----------
    alpha
        Rate of false alarms (``Options.alpha``).
    dof
        Degrees of freedom of the sum of squares, > 0.
    """
    return float(stats.chi2.isf(refuted(alpha), dof))


def unknown_gain(alpha: float) -> float:
    """Gain of unknown forces or signals that refutes the model [log evidence].

    Twice the gain has the distribution of half a chi2(1) if nothing is missing: the variance of the
    unknown force is at its limit zero in half of the cases.

    Parameters
    ----------
    alpha
        Rate of false alarms (``Options.alpha``).
    """
    return 0.5 * float(stats.chi2.isf(2.0 * refuted(alpha), 1))


def contradicted(alpha: float) -> float:
    """Distance of a held-out gain below that of a true effect that contradicts the effect [sd].

    Parameters
    ----------
    alpha
        Rate of false alarms (``Options.alpha``).
    """
    return float(stats.norm.isf(alpha))


def least_odds(credibility: float) -> float:
    """Held-out gain that confirms an effect: the odds of the credibility [log evidence].

    Parameters
    ----------
    credibility
        Posterior probability that a named effect needs (``Options.credibility``).
    """
    return math.log(credibility / (1.0 - credibility))


# ---------------------------------------------------------------- units

ANY_FACTOR = _number(
    "ANY_FACTOR", 0.5, "share of the value",
    "a parameter with at least this prior standard deviation can be wrong by any factor, so "
    "factors are not attributed to units",
    _JUDGED, "gap/test_overlay.py",
)  # fmt: skip
ALIKE = _number(
    "ALIKE", 0.9, "correlation",
    "correlation of record and model above which a factor is attributed to a wrong unit", _JUDGED,
    "gap/test_overlay.py",
)  # fmt: skip

NEAR_UNIT = _number(
    "NEAR_UNIT", 0.15, "share of the logarithm",
    "largest difference between a factor and that of a known unit, relative to the latter: what "
    "the model lacks changes the factor too",
    _JUDGED, "gap/test_overlay.py",
)  # fmt: skip
SAME_DELAY = _number(
    "SAME_DELAY", 0.3, "share of the mean",
    "largest spread of the delays of all channels that is reported as one delay of the clock",
    _JUDGED, "gap/test_thresholds.py",
)  # fmt: skip
DELAY_LEAVES = _number(
    "DELAY_LEAVES", 0.1, "share of the excess",
    "part of the misfit of the beginnings of all records, above noise and beyond the tolerances, "
    "that one delay of all outputs may leave: what the model lacks does not begin so early",
    _JUDGED, "adapters/test_common_delay.py",
)  # fmt: skip

# ---------------------------------------------------------------- is there a gap

ALPHA = _number(
    "ALPHA", 0.01, "rate", "default of `Options.alpha`, the family-wise rate of false alarms",
    _JUDGED, "gap/test_null.py",
)  # fmt: skip
NOISE_ERROR = _number(
    "NOISE_ERROR", 1.33, "1",
    "factor by which a noise that was estimated from the records may be wrong; a smaller residual "
    "is not unexplained, a smaller held-out gap is not tested, and the noise of blocks may differ "
    "by it",
    _JUDGED, "gap/test_rules.py",
)  # fmt: skip
ALLOWED_REST = _number(
    "ALLOWED_REST", 0.1, "noise",
    "rms of an unknown force or signal, in the residual, up to which it is no gap, however many "
    "samples make it significant",
    _JUDGED, "gap/test_smooth.py",
)  # fmt: skip
FORM = _number(
    "FORM", 0.03, "share of the force",
    "default of `Options.form`, the relative error of the force that a law of an effect gives: no "
    "law is exact. It is part of the interval of the magnitude",
    "form A of seeds 20261141, 20261142 and 20261144: 54 of 66 intervals cover without it, 63 with "
    "it", "gap/test_form.py",
)  # fmt: skip
FORM_ERROR = _number(
    "FORM_ERROR", 0.2, "share of the magnitude",
    "standard deviation between segments of the magnitude of an effect whose law is not exact",
    _JUDGED, "gap/test_evidence.py",
)  # fmt: skip
OTHER_LAW = _pair(
    "OTHER_LAW", (0.3, 1.0), "share of the magnitude",
    "the same for a cause that is not in the library and acts like the effect", _JUDGED,
    "gap/test_evidence.py",
)  # fmt: skip
FORM_LEFT = _number(
    "FORM_LEFT", 0.1, "share of the error of form",
    "amplitude of the residual that an error of form leaves, because magnitudes and parameters "
    "compensate the rest",
    _JUDGED, "gap/test_thresholds.py",
)  # fmt: skip
NO_GAP_RATIO = _number(
    "NO_GAP_RATIO", 1.1, "noise",
    "gap below which the closed share is meaningless, and factor by which a gap must grow to "
    "count as larger",
    _JUDGED, "gap/test_rules.py",
)  # fmt: skip

# ---------------------------------------------------------------- noise and unexplained residual

GIVEN_SIGMA = _number(
    "GIVEN_SIGMA", 0.2, "share of the sigma",
    "standard deviation of a given sigma, which is then estimated together with the other "
    "parameters; a residual that is larger by this share can be the noise of the sensor", _JUDGED,
    "gap/test_told_sigma.py",
)  # fmt: skip
GROWS = _number(
    "GROWS", 1.5, "1",
    "scatter of the largest values, over that of the smallest ones and over the noise that is "
    "used, above which noise in proportion to the value is looked for", _JUDGED,
    "gap/test_relative_noise.py",
)  # fmt: skip
NOT_WHITE = _pair(
    "NOT_WHITE", (0.8, 1.25), "1",
    "scatter in eighth differences over that in fourth differences: outside of this range it is "
    "a motion, not white noise", _JUDGED, "gap/test_relative_noise.py",
)  # fmt: skip
COLORED = _number(
    "COLORED", 0.2, "correlation",
    "correlation of neighboring samples above which the correlation time of the residual is "
    "estimated", _JUDGED, "gap/test_thresholds.py",
)  # fmt: skip
STILL_SHRINKS = _number(
    "STILL_SHRINKS", 0.85, "1",
    "ratio of the residual to that of the round before, above which the residual no longer "
    "decreases",
    _JUDGED, "gap/test_thresholds.py",
)  # fmt: skip
SLOW_COLOR = _number(
    "SLOW_COLOR", 0.3, "1",
    "product of frequency and correlation time of the noise up to which cosines are tested; "
    "at higher frequencies the single number of a data sheet does not describe the noise",
    _JUDGED, "gap/test_smooth.py",
)  # fmt: skip
AT_REST = _pair(
    "AT_REST", (0.4, 1.4), "noise",
    "range of the residual of a block of samples at rest", _JUDGED, "gap/test_color.py",
)  # fmt: skip
LEAST_BLOCKS = _number(
    "LEAST_BLOCKS", 5, "blocks",
    "smallest number of blocks that determines the correlation of the noise",
    _JUDGED, "gap/test_color.py",
)  # fmt: skip
COLOR_GAIN = _number(
    "COLOR_GAIN", 10.0, "log likelihood",
    "gain that another correlation of the noise needs over that of the data sheet",
    _JUDGED, "gap/test_color.py",
)  # fmt: skip
REST_SHARE = _number(
    "REST_SHARE", 0.1, "share of the spread",
    "largest standard deviation of blocks at rest, as a share of that of the record, if no noise "
    "is given; a vibration without rest would be taken for noise",
    _JUDGED, "gap/test_color.py",
)  # fmt: skip
FORGOTTEN = _number(
    "FORGOTTEN", 0.4, "1",
    "largest correlation between samples farther apart than the average that is taken for the "
    "noise, if no noise is given; samples of a vibration are correlated",
    _JUDGED, "gap/test_color.py",
)  # fmt: skip

# ---------------------------------------------------------------- data checks

COARSE = _number(
    "COARSE", 0.2, "share of the variance",
    "largest share of the variance that the digitizer may cause if the correlation of the "
    "noise is estimated; the rounding error of a slow motion is a sawtooth",
    _JUDGED, "gap/test_thresholds.py",
)  # fmt: skip
CLOCK_JUMP = _number(
    "CLOCK_JUMP", 20.0, "median step",
    "step of a clock above which it is a data problem", _JUDGED, "gap/test_data.py",
)  # fmt: skip
UNEVEN_STEP = _pair(
    "UNEVEN_STEP", (0.5, 1.5), "median step",
    "range of the steps of an even clock", _JUDGED, "gap/test_data.py",
)  # fmt: skip
OTHER_SCALE = _number(
    "OTHER_SCALE", 0.2, "share of the gap",
    "gap that another scale of temperature or time leaves in every record",
    _JUDGED, "gap/test_overlay.py",
)  # fmt: skip
WRONG_CLOCK = _number(
    "WRONG_CLOCK", 0.1, "share of the variance",
    "smallest squared gap of every record for which other units of the time are tried",
    _JUDGED, "gap/test_overlay.py",
)  # fmt: skip
REGULAR_CLOCK = _pair(
    "REGULAR_CLOCK", (0.1, 0.9), "median step, share",
    "distance from the median step, and share of the other steps within it, for which a long step "
    "is a missing row", _JUDGED, "gap/test_data.py",
)  # fmt: skip
BRIDGED = _number(
    "BRIDGED", 0.05, "standard deviation of the input",
    "error of a line over missing rows, up to which the input there is interpolated",
    _JUDGED, "gap/test_data.py",
)  # fmt: skip
WHOLE_STEPS = _pair(
    "WHOLE_STEPS", (0.02, 0.95), "step, share",
    "distance from a multiple of the smallest step between different values, and share of the "
    "steps within this distance, that identify a digitizer",
    _JUDGED, "gap/test_thresholds.py",
)  # fmt: skip
FINE_DIGITS = _number(
    "FINE_DIGITS", 0.01, "spread",
    "step of a digitizer below which equal extremes are the end of the range",
    _JUDGED, "gap/test_thresholds.py",
)  # fmt: skip
AWAY_FROM_REST = _number(
    "AWAY_FROM_REST", 0.5, "spread",
    "distance of an extreme from the median above which it is not the rest value",
    _JUDGED, "gap/test_data.py",
)  # fmt: skip
QUIET_BLOCKS = _number(
    "QUIET_BLOCKS", 0.5, "1",
    "ratio between the noise of the quietest tenth and the median noise below which the rest "
    "of the record is motion",
    _JUDGED, "gap/test_thresholds.py",
)  # fmt: skip
MOST_MISSING = _number(
    "MOST_MISSING", 0.5, "share of the values",
    "share of missing values above which a warning is given",
    _JUDGED, "gap/test_data.py",
)  # fmt: skip
FAR_CODE = _number(
    "FAR_CODE", 0.5, "range of the others",
    "distance from all other values above which a number such as -9999 is told as a code for a "
    "missing value", _JUDGED, "gap/test_outliers.py",
)  # fmt: skip
FAR_CERTAIN = _number(
    "FAR_CERTAIN", 5.0, "range of the others",
    "distance from all other values above which a number such as -9999 is certainly a code",
    _JUDGED, "gap/test_thresholds.py",
)  # fmt: skip
SPIKE = _number(
    "SPIKE", 15.0, "scatter",
    "distance of a sample from both neighbors, in one direction, above which it is a spike; the "
    "scatter is the median distance of all samples from the mean of their neighbors, or the "
    "largest of the samples two and three away",
    _JUDGED, "gap/test_thresholds.py",
)  # fmt: skip
SPIKE_RANGE = _number(
    "SPIKE_RANGE", 0.1, "range of the others",
    "smallest distance of a spike from both neighbors",
    _JUDGED, "gap/test_thresholds.py",
)  # fmt: skip
AGREE = _number(
    "AGREE", 0.2, "distance of the spike",
    "largest difference of the two neighbors of a spike; a step is none",
    _JUDGED, "gap/test_thresholds.py",
)  # fmt: skip
TARE = _number(
    "TARE", 0.02, "largest change of the force",
    "force before the motion above which it is told as a possible zero of the load cell",
    _JUDGED, "gap/test_thresholds.py",
)  # fmt: skip
MOST_CLIPPED = _number(
    "MOST_CLIPPED", 0.02, "share of the values",
    "share of values at the end of the range above which a warning is given",
    _JUDGED, "gap/test_data.py",
)  # fmt: skip

# ---------------------------------------------------------------- which effects are searched

FAINT_SCORE = _number(
    "FAINT_SCORE", 4.0, "T", "score below which a single effect is not refitted",
    _JUDGED, "gap/test_search.py",
)  # fmt: skip
NEAR_BEST = _number(
    "NEAR_BEST", 50.0, "log evidence",
    "distance to the best set above which another set is not an alternative",
    _JUDGED, "gap/test_search.py",
)  # fmt: skip
FITTED_SHAPE = _number(
    "FITTED_SHAPE", 3.0, "log evidence",
    "cost of a fitted shape parameter, which is known to a twentieth of its range",
    _STATISTICS, "gap/test_thresholds.py",
)  # fmt: skip

# ---------------------------------------------------------------- which effects are accepted

WALD = _number(
    "WALD", 3.0, "sd",
    "smallest distance of a magnitude from zero, or root of the score of the effect alone",
    _STATISTICS, "gap/test_rules.py",
)  # fmt: skip
EXPLAINS_MOST = _number(
    "EXPLAINS_MOST", 0.5, "share of the squared held-out gap",
    "share above which an effect is accepted although an unknown force would gain more, and below "
    "which it is not named if more than noise is left: it must explain more than remains. A shift "
    "or a factor that explains less is not reported",
    _JUDGED, "gap/test_rules.py",
)  # fmt: skip
TOLERATED = _number(
    "TOLERATED", 4.0, "sd",
    "largest accepted change of a parameter by a fit, in standard deviations of the change that "
    "its tolerance allows; with fifty parameters, one exceeds it in one of 300 machines",
    _STATISTICS, "adapters/test_aliases.py",
)  # fmt: skip

# ---------------------------------------------------------------- the verdict

NO_EFFECT = _number(
    "NO_EFFECT", 0.5, "probability",
    "prior probability that nothing is missing", _JUDGED, "gap/test_thresholds.py",
)  # fmt: skip
NOT_LISTED = _number(
    "NOT_LISTED", 0.1, "probability",
    "prior probability that something is missing that is not in the library, and share of the "
    "belief that a plan leaves to effects that a diagnosis considers impossible",
    _JUDGED, "gap/test_thresholds.py",
)  # fmt: skip
RIVAL = _number(
    "RIVAL", math.log(20.0), "log evidence",
    "difference up to which another set, another start of a fit, or a promised gain counts: odds "
    "of twenty",
    _STATISTICS, "gap/test_thresholds.py",
)  # fmt: skip
SURE = _number(
    "SURE", 0.9, "probability",
    "default of `Options.credibility`, the posterior probability that a named effect needs",
    _JUDGED, "gap/test_rules.py",
)  # fmt: skip

# ---------------------------------------------------------------- other reported results

LARGE_MOVE = _number(
    "LARGE_MOVE", 0.1, "share of the gap",
    "share above which the statement lists a changed parameter", _JUDGED,
    "gap/test_thresholds.py",
)  # fmt: skip
MOVED = _number(
    "MOVED", 2.0, "sd",
    "distance from its tabulated value above which a parameter counts as changed, and prior "
    "deviation above which a separate measurement of the part is recommended", _STATISTICS,
    "gap/test_thresholds.py",
)  # fmt: skip
SIGNATURE = _number(
    "SIGNATURE", 0.15, "share of a recovered force",
    "share of a reconstructed force above which its form is reported",
    _JUDGED, "gap/test_thresholds.py",
)  # fmt: skip
SECOND_SIGNATURE = _number(
    "SECOND_SIGNATURE", 0.7, "share of the largest share",
    "share, relative to the largest, above which another form is also reported",
    _JUDGED, "gap/test_thresholds.py",
)  # fmt: skip
ONSET_SHARE = _number(
    "ONSET_SHARE", 0.1, "share of noise and of the largest",
    "difference of an output above which an effect is visible", _JUDGED, "gap/test_thresholds.py",
)  # fmt: skip

# ---------------------------------------------------------------- plans and advice

DETECTABLE = _number(
    "DETECTABLE", 3.7, "signal-to-noise ratio",
    "ratio that is detected in nine of ten records at one false alarm in a hundred: 3.6 for an "
    "effect of one sign, 3.9 for both signs",
    _STATISTICS,
    "gap/test_planning.py",
)  # fmt: skip
CLEAR_SIGNAL = _number(
    "CLEAR_SIGNAL", 5.0, "signal-to-noise ratio",
    "ratio above which an effect stands out clearly",
    _JUDGED, "gap/test_thresholds.py",
)  # fmt: skip
CONFUSED = _number(
    "CONFUSED", 0.1, "probability",
    "probability of confusion above which two effects are one class and an experiment is not "
    "recommended",
    _JUDGED, "gap/test_thresholds.py",
)  # fmt: skip
BETTER_SENSOR = _number(
    "BETTER_SENSOR", 3.0, "1",
    "factor by which the noise of a proposed sensor is lower",
    _JUDGED, "gap/test_thresholds.py",
)  # fmt: skip

WORTH_TELLING = _number(
    "WORTH_TELLING", 0.02, "probability",
    "decrease of the probability of confusion above which an experiment is reported, and "
    "expected gain below which a session ends",
    _JUDGED, "gap/test_advise.py",
)  # fmt: skip
BEST_PART = _number(
    "BEST_PART", 0.1, "share of the tolerance",
    "best standard deviation that the test of a single part is assumed to reach",
    _JUDGED, "gap/test_design.py",
)  # fmt: skip


@dataclass(frozen=True)
class Derived:
    """A limit that follows from the numbers of the user."""

    name: str
    formula: str
    value: Callable[[], float]
    """Value at the defaults."""
    unit: str
    meaning: str


DERIVED = (
    Derived(
        "refuted", "alpha^2", lambda: refuted(ALPHA), "1",
        "p of the largest score below which the model is refuted, even if held-out records refuse "
        "the effect with this score",
    ),
    Derived(
        "squares_of_noise", "chi2.isf(alpha^2, n) / n", lambda: squares_of_noise(ALPHA, 1e3) / 1e3,
        "1", "sum of squares over its expectation above which a residual is more than noise (n = "
        "1000 samples)",
    ),
    Derived(
        "unknown_gain", "chi2.isf(2 alpha^2, 1) / 2", lambda: unknown_gain(ALPHA), "log evidence",
        "gain of unknown forces or signals above which there is a gap of any cause",
    ),
    Derived(
        "contradicted", "norm.isf(alpha)", lambda: contradicted(ALPHA), "sd",
        "distance of a held-out gain below that of a true effect, above which the held-out records "
        "contradict the effect",
    ),
    Derived(
        "least_odds", "log(credibility / (1 - credibility))", lambda: least_odds(SURE),
        "log evidence", "gain that held-out records must show",
    ),
    Derived(
        "alpha", "alpha", lambda: ALPHA, "rate",
        "rate of false discoveries among cells of channel and time, among events, and among "
        "components",
    ),
)  # fmt: skip


def table() -> str:
    """The limits and criteria as two tables in Markdown."""
    lines = ["| name | formula | at the defaults | unit | meaning |", "|---|---|---|---|---|"]
    for d in DERIVED:
        lines.append(f"| `{d.name}` | `{d.formula}` | {d.value():.4g} | {d.unit} | {d.meaning} |")
    lines += ["", "| name | value | unit | reason | set on | test |", "|---|---|---|---|---|---|"]
    for c in CRITERIA:
        values = c.value if isinstance(c.value, tuple) else (c.value,)
        shown = ", ".join(f"{v:.4g}" for v in values)
        lines.append(f"| `{c.name}` | {shown} | {c.unit} | {c.reason} | {c.data} | `{c.test}` |")
    return "\n".join(lines) + "\n"
