"""A sweep: its arguments, its members, and its table."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from feltmb.display import html_table
from feltmb.mechanism import Action, load_action, plain_data
from feltmb.mechanism.parameters import notes_of_paths
from feltmb.mechanism.values import apply_values, split_operator
from feltmb.run.arrays import summary_unit, table_to_dataset
from feltmb.run.options import OPTIONS, RunOptions, check_options, options_given
from feltmb.run.stroke import Stroke, load_stroke
from feltmb.run.sweep.axes import Axis, apply_point, axis_values, grid_points
from feltmb.run.sweep.members import Member, Outcome, one_line, run_members
from feltmb.run.sweep.progress import Progress, ProgressBar
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter, shown
from unmodeled.files import check_suffix, make_folder, write_text

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from feltmb.run.results import Run

#: Number of rows that a notebook shows.
MOST_ROWS = 20


@dataclass(frozen=True, eq=False)
class SweepResult:
    """Result of a sweep.

    Attributes
    ----------
    table : DataFrame
        One row for each member, in the order of the values, the last path varying fastest. Columns:
        each path, ``stroke``, ``status``, ``error``, ``warnings``, and the summary of the run in SI
        units with ``steps`` and ``rhs``. NaN: the run does not have the value.
    notes : tuple of str
        Paths with numbers without a unit, which are in SI units, where the file of the mechanism
        has another unit.
    """

    table: pd.DataFrame
    notes: tuple[str, ...] = ()
    _runs: tuple[str, ...] = ()
    _axes: Mapping[str, str] = field(default_factory=dict)
    """Column of each varied path -> unit of its values."""

    def __repr__(self) -> str:
        warned = int((self.table["warnings"] != "").sum())
        more = f", {warned} with warnings" if warned else ""
        told = "".join(f"\n  {note}" for note in self.notes)
        return f"SweepResult({len(self.table)} members, {len(self.failed)} failed{more}){told}"

    def _repr_html_(self) -> str:
        rows = self.table.head(MOST_ROWS).itertuples(index=False, name=None)
        return html_table(repr(self), [str(c) for c in self.table.columns], rows)

    def to_xarray(self) -> xr.Dataset:
        """Table as a dataset with units.

        Returns
        -------
        Dataset
            Dataset; its dimensions are the paths and ``stroke`` if all combinations were simulated,
            else ``member``. Variables are the columns of the table; the attribute ``units`` is the
            unit, for a path the SI unit.
        """
        numbers = [str(c) for c in self.table.select_dtypes("number").columns]
        units = {name: summary_unit(name) for name in numbers} | dict(self._axes)
        return table_to_dataset(self.table, [*self._axes, "stroke"], units)

    def __len__(self) -> int:
        return len(self.table)

    @property
    def failed(self) -> pd.DataFrame:
        """Rows whose status is not ``done``."""
        return self.table[self.table["status"] != "done"]

    @checked
    def run(self, index: int) -> Run:
        """Read the run of a member; the sweep must have been called with ``summary_only=False``."""
        from feltmb.run.results import load_run

        if not self._runs:
            raise InvalidParameter("the sweep kept no runs; call it with summary_only=False")
        return load_run(self._runs[index])

    @checked
    def save(self, path: str | Path, *, force: bool = False) -> Path:
        """Write the table as CSV in SI units."""
        check_suffix(Path(path), ".csv")
        return write_text(Path(path), self.table.to_csv(index=False), force=force)


@checked
def sweep(
    action: Action | str,
    stroke: Stroke | str | Sequence[Stroke | str],
    values: Mapping[str, Any] | Sequence[Mapping[str, Any]],
    *,
    mode: Literal["grid", "list"] = "grid",
    options: RunOptions | Mapping[str, Any] | None = None,
    executor: Executor | None = None,
    jobs: int | None = None,
    folder: str | Path | None = None,
    summary_only: bool = True,
    progress: Progress | bool | None = None,
) -> SweepResult:
    """Simulate for values of parameters.

    Parameters
    ----------
    action, stroke
        Objects or names; with several strokes, each is simulated at each point.
    values
        ``{path: values}``: all combinations (or ``mode="list"``: pairs). Paths are paths of
        :meth:`Action.with_values`, ``stroke.scale``, ``stroke.delay`` [s], ``stroke.duration`` [s],
        ``options.rtol`` and so on. Values are a list; or
        ``{"from": 1, "to": 4, "count": 7, "spacing": "log"}``; or ``{"scale": values}``, factors of
        the value of the mechanism; or ``{"offset": values}``, which are added to it. A number
        without a unit is in SI units, also in a range; ``"0.1 mm"`` has a unit. Instead of a
        dictionary, a list of ``{path: value}`` has one entry for each point.
    options
        Options of ``simulate``; the ledger is off by default.
    executor
        Any ``concurrent.futures.Executor``: a process pool, ``client.get_executor()`` of Dask. It
        is not shut down. Default: threads.
    jobs
        Number of threads without an executor; default: one per core.
    folder
        Folder with one small file for each finished member. An interrupted sweep continues from
        there, and nothing is computed twice. A member is identified by its parameters, stroke,
        options and code.
    summary_only
        False: each run is also written as NetCDF to ``folder``, to which every worker must have
        access.
    progress
        ``progress(done, total, name)``, whose result is ignored; default: a bar on a terminal;
        False: none.

    Returns
    -------
    SweepResult
        Result; a failed member has its error in the table, and the others are not affected. The
        table does not depend on the executor or the number of workers.

    Raises
    ------
    InvalidParameter
        An argument is invalid. A value out of range only makes its member fail.

    Examples
    --------
    A weak and a strong press, 1 ms each:

    >>> import feltmb
    >>> strokes = [feltmb.pulse_stroke(force, 0.0) for force in (5.0, 10.0)]
    >>> result = feltmb.sweep(
    ...     "steinway45", strokes, {}, options={"duration": 1e-3}, jobs=1, progress=False
    ... )
    >>> list(result.table["status"])
    ['done', 'done']
    """
    import pandas as pd

    base = load_action(action) if isinstance(action, str) else action
    loaded = _strokes(stroke)
    values, given = _numbers(values, "values"), _numbers(options_given(options), "options")
    check_options(given, known=OPTIONS)
    where = Path(folder) if folder is not None else None
    if where is not None:
        make_folder(where)
    if not summary_only and where is None:
        raise InvalidParameter("sweep: runs are kept in a folder; give folder=")

    names, points = _points(base, values, mode)
    rows: list[dict[str, Any]] = []
    members: list[Member] = []
    faults: dict[int, Outcome] = {}
    for point, changes in points:
        label = " ".join(f"{n.rsplit('.', 1)[-1]}={v}" for n, v in zip(names, point, strict=True))
        for s in loaded:
            rows.append({**dict(zip(names, point, strict=True)), "stroke": s.name})
            try:
                mechanism, changed, chosen = apply_point(s, given, changes)
            except InvalidParameter as failure:
                faults[len(members)] = Outcome("failed", one_line(failure))
                mechanism, changed, chosen = {}, s, given
            member = Member(base, changed, mechanism, chosen, f"{s.name} {label}".strip())
            members.append(member if summary_only else _kept(member, where))
    outcomes: list[Outcome | None] = [faults.get(i) for i in range(len(members))]
    numbered = [(i, m) for i, m in enumerate(members) if i not in faults]
    if jobs is not None:
        jobs = min(int(jobs), max(1, len(numbered)))
    found = run_members((m for _, m in numbered), executor=executor, jobs=jobs, folder=where)
    with closing(found), ProgressBar(progress, len(numbered), "sweep") as bar:
        for k, outcome in found:
            index, member = numbered[k]
            outcomes[index] = outcome
            bar.step(member.name)
    return SweepResult(
        _table(rows, outcomes, pd),
        tuple(notes_of_paths(base, _plain(values))),
        tuple(m.save_run for m in members) if not summary_only else (),
        _units(base, names, values),
    )


def _strokes(stroke: Stroke | str | Sequence[Stroke | str]) -> list[Stroke]:
    given = [stroke] if isinstance(stroke, (Stroke, str)) else list(stroke)
    if not given:
        raise InvalidParameter("sweep: no stroke")
    return [load_stroke(s) if isinstance(s, str) else s for s in given]


def _numbers(given: Any, where: str) -> Any:
    """Plain data of values or options, with numbers that can be simulated."""
    try:
        plain = plain_data(given)
    except InvalidParameter as error:
        raise InvalidParameter(f"sweep: {error}") from None
    _check_sizes(plain, where)
    return plain


def _kept(member: Member, folder: Path | None) -> Member:
    """A member that writes its run to the folder."""
    assert folder is not None
    marked = replace(member, save_run="yes")
    return replace(member, save_run=str(folder / f"{marked.key[:40]}.nc"))


def _units(action: Action, names: Sequence[str], values: Any) -> dict[str, str]:
    """SI unit of the values of each path; "" if unknown."""
    known = {"stroke.scale": "1", "stroke.delay": "s", "stroke.duration": "s"}
    for name in names:
        given = values[name] if isinstance(values, Mapping) else ()
        if isinstance(given, Mapping) and "scale" in given:
            known[name] = "1"
        elif any(isinstance(v, str) for v in _plain({name: given})[name]):
            known[name] = ""  # each has its own
        elif name not in known:
            try:
                known[name] = action.value(split_operator(name)[0]).unit
            except InvalidParameter:  # a text, several paths, or an option
                known[name] = ""
    return {name: known[name] for name in names}


def _plain(values: Any) -> dict[str, list[Any]]:
    """Values by path that replace or are added; the factors of a path are left out."""
    if not isinstance(values, Mapping):
        return {path: [p[path] for p in values if path in p] for p in values for path in p}
    out = {}
    for path, given in values.items():
        inner = given.get("offset", given) if isinstance(given, Mapping) else given
        if not (isinstance(inner, Mapping) and "scale" in inner):
            out[path] = [inner["from"], inner["to"]] if isinstance(inner, Mapping) else list(inner)
    return out


def _check_sizes(node: Any, where: str) -> None:
    """Reject integers that are too large for a float; they cannot be simulated."""
    if isinstance(node, int) and abs(node) > sys.float_info.max:
        raise InvalidParameter(
            f"sweep: {where}: got {shown(node)}, expected a number that a float can hold"
        )
    if isinstance(node, Mapping):
        for key, inner in node.items():
            _check_sizes(inner, f"{where}.{key}")
    elif isinstance(node, list):
        for inner in node:
            _check_sizes(inner, where)


def _points(
    action: Action, values: Mapping[str, Any] | Sequence[Mapping[str, Any]], mode: str
) -> tuple[list[str], Iterator[tuple[tuple[Any, ...], dict[str, Any]]]]:
    if mode not in ("grid", "list"):
        raise InvalidParameter(f"mode = {mode!r}, expected 'grid' or 'list'")
    if isinstance(values, Mapping):
        axes = []
        for path, given in values.items():
            found, how = axis_values(given, f"values[{path!r}]")
            axes.append(Axis(path, found, how))
            if how != "set":  # the path must name numbers
                apply_values(action.raw, axes[-1].at(found[0]), "sweep")
        combined = grid_points(axes, mode)  # type: ignore[arg-type]

        def expand() -> Iterator[tuple[tuple[Any, ...], dict[str, Any]]]:
            for point in combined:
                changes: dict[str, Any] = {}
                for axis, value in zip(axes, point, strict=True):
                    changes.update(axis.at(value))
                yield point, changes

        return [axis.path for axis in axes], expand()
    listed = [dict(v) for v in values]
    paths = list(dict.fromkeys(path for point in listed for path in point))
    if not listed:
        raise InvalidParameter("values: has no points")
    return paths, iter([(tuple(p.get(path) for path in paths), p) for p in listed])


def _table(rows: list[dict[str, Any]], outcomes: Sequence[Outcome | None], pd: Any) -> Any:
    """Rows with their outcomes; columns of values in the order of their first appearance."""
    numbers = list(dict.fromkeys(k for o in outcomes if o is not None for k in o.numbers))
    numbers = [n for n in numbers if n not in ("steps", "rhs")] + ["steps", "rhs"]
    full = []
    for row, outcome in zip(rows, outcomes, strict=True):
        found = outcome or Outcome("error", "was not run")
        full.append(
            {
                **row,
                "status": found.status,
                "error": found.error,
                "warnings": "; ".join(found.warnings),
                **{n: found.numbers.get(n, math.nan) for n in numbers},
            }
        )
    return pd.DataFrame(full)
