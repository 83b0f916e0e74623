"""Input and result of a computation of derivatives: segments and gradients."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

from feltmb import _core
from feltmb.display import html_table, picture
from feltmb.mechanism import Action
from feltmb.mechanism.parameters import Parameter
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter, no_such

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

    Array = npt.NDArray[np.float64]


@checked
@dataclass(frozen=True)
class Segment:
    """A time segment of a stroke that starts from a full state.

    Attributes
    ----------
    begin, end
        Start and end in the time of the stroke [s].
    state
        Full state at ``begin`` in the order of :func:`state_names`; None: the rest pose.
    memory
        Largest compression that each contact remembers [m]; None: as at rest, zero.
    """

    begin: float
    end: float
    state: npt.ArrayLike | None = None
    memory: npt.ArrayLike | None = None


@dataclass(frozen=True, eq=False)
class Gradient:
    """Outputs of a stroke and their derivatives, all in SI units.

    Attributes
    ----------
    time : ndarray (n_times,)
        Sample times in the time of the stroke [s].
    outputs : tuple of str
        Names as in a run; ``output_units`` are their units.
    values : ndarray (n_times, n_outputs)
    columns : tuple of str
        Variables of differentiation: parameters by path, then ``start.NAME`` for directions of the
        start state; ``column_units`` are their units.
    parameters : tuple of Parameter
        Parameters of the first columns, with value, unit and size.
    array : ndarray (n_times, n_outputs, n_columns)
        d output / d column [unit of the output / unit of the column].
    summary : dict
        Values of ``Run.summary`` that have a derivative, SI units.
    summary_gradient : dict of ndarray (n_columns,)
        Derivatives of these values.
    summary_units : dict of str
        SI units of these values.
    unknown : dict of str
        Why the derivatives of a value are NaN, by the name of the value.
    events : tuple of dict
        One entry for each event that has a derivative: ``event``, ``time`` [s], and ``gradient``
        (n_columns,), the derivative of the time.
    end_state, end_memory : ndarray
        Full state and remembered compressions at the end.
    end_gradient : ndarray (n_states, n_columns)
    end_memory_gradient : ndarray (n_contacts, n_columns)
    stats : dict
        Work counts and wall times of the stroke and of the derivatives.
    """

    time: Array
    outputs: tuple[str, ...]
    output_units: tuple[str, ...]
    values: Array
    columns: tuple[str, ...]
    column_units: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    array: Array
    summary: dict[str, float]
    summary_gradient: dict[str, Array]
    summary_units: dict[str, str]
    unknown: dict[str, str]
    events: tuple[dict[str, Any], ...]
    end_state: Array
    end_memory: Array
    end_gradient: Array
    end_memory_gradient: Array
    stats: dict[str, Any]
    provenance: dict[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        return (
            f"Gradient({len(self.outputs)} outputs at {len(self.time)} times by "
            f"{len(self.columns)} columns)"
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """Numbers of the mechanism that may have been meant in the unit of its file."""
        return tuple(self.stats["warnings"])

    def _repr_html_(self) -> str:
        table = self.effects()
        names = [f"{name} [{self.summary_units[name]}]" for name in table.columns]
        rows = [
            (path, *map(float, values))
            for path, values in zip(table.index, table.to_numpy(), strict=True)
        ]
        return html_table(f"{self!r}: what 1 % more does", ("parameter", *names), rows)

    @checked
    def plot(self, number: str | None = None, most: int = 20) -> Figure:
        """Plot the change of a value of the summary for 1 % more of each parameter.

        Parameters
        ----------
        number
            Name of the value; default: ``impact_speed``, or the first one of the stroke.
        most
            Number of parameters that are shown, starting with the largest effect.

        Returns
        -------
        Figure
            Figure of matplotlib.
        """
        table = self.effects()
        if number is None:
            number = "impact_speed" if "impact_speed" in table else next(iter(table), "")
        if number not in table:
            known = ", ".join(table.columns)
            raise InvalidParameter(f"plot: number = {number!r}, expected one of: {known}")
        order = table[number].abs().sort_values(ascending=False).index[:most]
        return picture("effects", table.loc[order, number], self.summary_units[number])

    @checked
    def of(self, output: str, column: str | None = None) -> Array:
        """Derivative of an output over time by one column, (n_times,), or by all columns."""
        out: Array = self.array[:, place_of(output, self.outputs, "output"), :]
        return out if column is None else out[:, place_of(column, self.columns, "column")]

    @cached_property
    def data(self) -> xr.Dataset:
        """``values`` (time, output) and ``gradient`` (time, output, column), with units."""
        import xarray as xr

        return xr.Dataset(
            {
                "values": (("time", "output"), self.values),
                "gradient": (("time", "output", "column"), self.array),
            },
            coords={
                "time": ("time", self.time, {"units": "s"}),
                "output": list(self.outputs),
                "output_unit": ("output", list(self.output_units)),
                "column": list(self.columns),
                "column_unit": ("column", list(self.column_units)),
            },
        )

    @checked
    def effects(self, change: float = 0.01) -> pd.DataFrame:
        """Change of each value of the summary by a relative change of each parameter.

        Parameters
        ----------
        change
            Relative change with respect to the size of a parameter; 0.01 is one percent.

        Returns
        -------
        DataFrame
            Table; rows: parameters; columns: values of the summary, SI units.
        """
        import numpy as np
        import pandas as pd

        sizes = np.array([p.size for p in self.parameters])
        n = len(sizes)
        return pd.DataFrame(
            {name: change * sizes * g[:n] for name, g in self.summary_gradient.items()},
            index=pd.Index([p.path for p in self.parameters], name="parameter"),
        )


def place_of(name: str, names: Sequence[str], what: str) -> int:
    """Index of a name; an unknown name raises a message with similar names."""
    if name not in names:
        raise no_such(what, name, names)
    return names.index(name)


@checked
def state_names(action: Action) -> tuple[str, ...]:
    """Names of the full state: coordinates, their rates, states of laws, modes and their rates."""
    return tuple(_core.state_names(action.mechanism))
