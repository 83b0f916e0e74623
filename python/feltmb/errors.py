"""Exceptions of simulations; the others are those of :mod:`unmodeled.errors`."""

from __future__ import annotations

from typing import Any

from unmodeled.errors import Error


class IntegrationError(Error):
    """The solver stopped early, or its result is unreliable.

    Attributes
    ----------
    code : str
        ``"not_converged"``, ``"no_progress"``, ``"too_many_steps"``, ``"wall_time"``,
        ``"not_finite"``, ``"beyond_string"``, ``"energy_balance"``, or that of an exception in the
        equations.
    partial : feltmb.Run or feltmb.actuator.ActuatorRun
        The run until the failure, complete up to ``time``.
    time : float
        Time reached [s].
    state, contact : str
        The state with the largest error at the failure, and the stiffest contact that acts on it.
    """

    def __init__(
        self,
        message: str,
        *,
        partial: Any,
        time: float,
        state: str,
        contact: str,
        code: str = "other",
    ):
        super().__init__(message)
        self.code = code
        self.partial = partial
        self.time = time
        self.state = state
        self.contact = contact
