"""One simulation of a sweep, its key, and its outcome."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

from feltmb.arguments import checked
from feltmb.errors import FeltmbError, IntegrationError
from feltmb.files import digest_of, package_digest
from feltmb.mechanism import Action
from feltmb.run.stroke import Stroke

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from feltmb.run.results import Run

    Array = npt.NDArray[np.float64]


@checked
@dataclass(frozen=True)
class Extract:
    """Values and series that are taken from a run.

    Attributes
    ----------
    function
        Module-level function ``function(run, action, spec) -> (numbers, series)``.
    spec
        Plain data for the function; part of the key of a member.
    """

    function: Callable[[Run, Action, Any], tuple[dict[str, float], dict[str, Array]]]
    spec: Any


@checked
@dataclass(frozen=True)
class Member:
    """One simulation: mechanism, values by dotted path, stroke, options of ``simulate``."""

    action: Action
    stroke: Stroke
    values: Mapping[str, Any] = field(default_factory=dict)
    options: Mapping[str, Any] = field(default_factory=dict)
    name: str = ""
    extract: Extract | None = None
    save_run: str = ""  #: NetCDF file to be written; "" for none

    @property
    def summary_only(self) -> bool:
        """Whether the samples of the outputs are not needed."""
        return self.extract is None and not self.save_run

    def changed_action(self) -> Action:
        """The mechanism with the values of this member."""
        return self.action.with_values(self.values) if self.values else self.action

    def simulate_options(self) -> dict[str, Any]:
        """Options of ``simulate``."""
        return {"ledger": False, "summary_only": self.summary_only, **self.options}

    @cached_property
    def key(self) -> str:
        """SHA-256 of parameters, stroke, options, extracted values, and code."""
        return digest_of(
            package_digest(),
            self.action.hash,
            self.values,
            self.stroke.as_dict(),
            self.options,
            None if self.extract is None else self.extract.spec,
            bool(self.save_run),
        )


@dataclass(frozen=True)
class Outcome:
    """Outcome of a member.

    Attributes
    ----------
    status
        ``done``; ``failed``: the solver stopped early (the outcome has what was reached), or the
        values are impossible; ``error``: another fault (a worker process died, the wall time limit
        was reached). A member with ``error`` is repeated when the sweep continues.
    error
        Message in one line; empty if done.
    numbers
        Summary of the run and extracted values, SI units; ``steps`` and ``rhs``: work counts.
    series
        Extracted arrays.
    wall
        Wall time of the simulation [s].
    warnings
        Warnings of the run (:attr:`Run.warnings`).
    resumed
        Whether it was read from the folder instead of computed.
    """

    status: str
    error: str = ""
    numbers: dict[str, float] = field(default_factory=dict)
    series: dict[str, Array] = field(default_factory=dict)
    reached: float = 0.0
    wall: float = 0.0
    warnings: tuple[str, ...] = ()
    resumed: bool = False


def one_line(error: BaseException) -> str:
    """Message of an error, with its type if it is not an error of feltmb."""
    text = " ".join(str(error).split())
    return (
        text if isinstance(error, FeltmbError) else f"{type(error).__name__}: {text}".rstrip(": ")
    )


def failure_outcome(error: Exception) -> Outcome:
    """Outcome of a member without a run."""
    return Outcome("failed" if isinstance(error, FeltmbError) else "error", one_line(error))


def to_outcome(member: Member, action: Action, result: Run | FeltmbError) -> Outcome:
    """Outcome of a member, from its run or from an error.

    Parameters
    ----------
    action
        The mechanism with the values of the member.
    """
    status, error = "done", ""
    if isinstance(result, IntegrationError):
        run, error = result.partial, one_line(result)
        if run.status != "failed":  # the state at a wall time limit is random
            return Outcome("error", error, reached=run.reached, wall=float(run.stats["wall"]))
        status = "failed"
    elif isinstance(result, FeltmbError):
        return failure_outcome(result)
    else:
        run = result
    try:
        numbers = {k: float(v) for k, v in run.summary.items()}
        series: dict[str, Array] = {}
        if member.extract is not None and run.time.size > 1:
            more, series = member.extract.function(run, action, member.extract.spec)
            numbers.update(more)
        if member.save_run:
            try:
                run.save(member.save_run, force=True)
            except FeltmbError as failure:  # a fault of the disk, not of the member: it is repeated
                return Outcome("error", one_line(failure))
    except Exception as failure:  # a member must not stop the others
        return failure_outcome(failure)
    numbers.update(steps=float(run.stats["steps"]), rhs=float(run.stats["rhs"]))
    wall = float(run.stats["wall"])
    return Outcome(status, error, numbers, series, run.reached, wall, run.warnings)


@checked
def run_member(member: Member) -> Outcome:
    """Simulate one member, in any process; every fault becomes its outcome."""
    from feltmb.run.simulate import simulate

    try:
        action = member.changed_action()
        result: Run | FeltmbError
        try:
            result = simulate(action, member.stroke, **member.simulate_options())
        except IntegrationError as failure:
            result = failure
    except Exception as failure:  # a member must not stop the others
        return failure_outcome(failure)
    return to_outcome(member, action, result)
