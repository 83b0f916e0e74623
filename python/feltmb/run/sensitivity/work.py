"""Computation of derivatives of a stroke or of its segments."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from feltmb import _core
from feltmb.errors import IntegrationError
from feltmb.mechanism import Action, load_action
from feltmb.mechanism.parameters import Parameter
from feltmb.run.sensitivity.objects import Gradient, Segment, place_of, state_names
from feltmb.run.sensitivity.shifting import choose_parameters, shifted
from feltmb.run.sensitivity.summary import Summary, add_rules, looks_of, summarize
from feltmb.run.simulate import check_input
from feltmb.run.stroke import Stroke, load_stroke
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Array = npt.NDArray[np.float64]


#: Beyond them, a gradient fills the memory or never ends [s, 1].
LONGEST, SMALLEST_TOLERANCE = 100.0, 1e-14


@checked
def gradient(
    action: Action | str,
    stroke: Stroke | str,
    parameters: str | Iterable[str] | None = None,
    outputs: Iterable[str] | None = None,
    *,
    duration: float | None = None,
    rtol: float = 1e-9,
    tolerance: float = 1e-4,
    output_rate: float = 1000.0,
) -> Gradient:
    """Compute the derivatives of a stroke that starts at rest, including those of the rest pose.

    Parameters
    ----------
    action, stroke
        Objects, or names for ``load_action`` and ``load_stroke``.
    parameters
        Dotted paths as for ``--set``, with ``*`` for any name; ``stroke.scale`` [1] multiplies the
        input, ``stroke.delay`` [s] shifts it. Default: every real number of the mechanism that can
        be shifted. Derivatives are by values in SI units.
    outputs
        Names of outputs as in a run; default: coordinates, tracking points, and forces and
        compressions of the contacts.
    duration
        Duration [s]; default: the duration of the stroke.
    rtol
        Relative tolerance of the stroke. A sensitive motion has even more sensitive derivatives;
        the default is therefore far below that of ``simulate``.
    tolerance
        Local error of each column relative to the largest motion that its parameter causes, above
        0, at most 0.1. An output that is a small difference of such motions (for example the force
        between two parts that a parameter moves together) has a larger relative error: compare with
        a tenth of the tolerance.
    output_rate
        Sample rate of the outputs [Hz]; events and peaks do not depend on it.

    Raises
    ------
    InvalidParameter
        A path or output does not exist (all are in one message), or the shift of a parameter
        changes the number of states.
    IntegrationError
        The stroke failed; ``error.partial`` is None.

    Notes
    -----
    The summary has times of events, impact and rebound speed, duration of the impact, let-off gap,
    largest force of the impact and its time, key travel, and the rows of ``[reading]``. Extrema are
    those of the motion itself, not of samples; a mean is that of samples at ``output_rate``. The
    derivatives include the shift of the times of their events. ``Gradient.unknown`` says why a
    derivative is NaN.
    """
    action = load_action(action) if isinstance(action, str) else action
    stroke = load_stroke(stroke) if isinstance(stroke, str) else stroke
    end = float(stroke.duration if duration is None else duration)
    if not end <= LONGEST or (tolerance is not None and tolerance < SMALLEST_TOLERANCE):
        raise InvalidParameter(
            f"gradient: duration = {end:g} s and tolerance = {tolerance}, expected at most "
            f"{LONGEST:g} s and at least {SMALLEST_TOLERANCE:g}"
        )
    return segments(
        action,
        stroke,
        [Segment(0.0, end)],
        parameters,
        outputs,
        directions=None,
        rtol=rtol,
        tolerance=tolerance,
        output_rate=output_rate,
        jobs=1,
    )[0]


@checked
def segments(
    action: Action | str,
    stroke: Stroke | str,
    segments: Sequence[Segment],
    parameters: str | Iterable[str] | None = None,
    outputs: Iterable[str] | None = None,
    *,
    directions: str | Sequence[str] | npt.ArrayLike | None = "mechanical",
    rtol: float = 1e-9,
    tolerance: float = 1e-4,
    output_rate: float = 1000.0,
    jobs: int | None = None,
) -> list[Gradient]:
    """Compute the derivatives of several segments of a stroke, each from its own full state.

    Multiple shooting needs these derivatives. With ``directions``, the columns after the parameters
    are derivatives by the start state of each segment.

    Parameters
    ----------
    segments
        See :class:`Segment`. A segment without a state starts from the rest pose, which depends on
        the parameters; a given state does not depend on them.
    parameters
        As in :func:`gradient`; default: none.
    directions
        ``"mechanical"``: by every coordinate and rate; ``"all"``: by every state; or names of
        states; or an array (n_states, n_directions); or None.
    jobs
        Number of threads; default: one per core. The results do not depend on it.
    """
    action = load_action(action) if isinstance(action, str) else action
    stroke = load_stroke(stroke) if isinstance(stroke, str) else stroke
    from_rest = len(segments) == 1 and segments[0].state is None and directions is None
    check_input(action, stroke)
    chosen = choose_parameters(action, parameters, every=from_rest and parameters is None)
    infos = {name: (i, unit) for i, (name, unit, _) in enumerate(_observables(action))}
    names = _choose_outputs(action, infos, outputs)

    options = _core.SensitivityOptions()
    simulation = _core.SimulationOptions()
    simulation.rtol = float(rtol)
    strike = action.config.reading.strike_contact
    if strike is not None:
        simulation.peak_contacts = [strike]
    options.simulation = simulation
    options.tolerance = float(tolerance)
    options.output_rate = float(output_rate)
    options.outputs = [infos[n][0] for n in names]
    options.threads = 0 if jobs is None else _positive(jobs)
    rules = add_rules(action, options)
    choose = looks_of(action, infos, rules, output_rate)
    options.set_looks(lambda run: [look for _, look in choose(run)])
    start_names, matrix = _directions(action, directions)
    columns = tuple(p.path for p in chosen) + tuple(f"start.{n}" for n in start_names)
    units = tuple(p.unit for p in chosen) + tuple(_state_unit(action, n) for n in start_names)
    prepared = [_segment(action, w, matrix) for w in segments]
    results = _core.sensitivities(
        action.mechanism,
        stroke.input,
        [shifted(action, stroke, p) for p in chosen],
        prepared,
        options,
    )
    provenance = {
        "feltmb": "gradient",
        "version": _core.__version__,
        "action": action.name,
        "hash": action.hash,
        "stroke": stroke.as_dict(),
        "options": {"rtol": float(rtol), "tolerance": float(tolerance)},
    }

    def sum_up(result: Any) -> Summary:
        return summarize(action, result, rules, infos, choose)

    doubts = action.doubts
    return [
        _to_gradient(r, w, names, infos, chosen, columns, units, provenance, sum_up, doubts)
        for r, w in zip(results, segments, strict=True)
    ]


@checked
def state_at(
    action: Action | str, stroke: Stroke | str, times: Sequence[float], *, rtol: float = 1e-9
) -> list[Segment]:
    """Segments between given times of a stroke, each with the state of the stroke at its start.

    Parameters
    ----------
    times
        Increasing times [s]; the first may be 0, the rest pose.

    Returns
    -------
    list of Segment
        One segment for each pair of consecutive times.
    """
    action = load_action(action) if isinstance(action, str) else action
    stroke = load_stroke(stroke) if isinstance(stroke, str) else stroke
    cuts = [float(t) for t in times]
    if len(cuts) < 2 or any(b <= a for a, b in itertools.pairwise(cuts)) or cuts[0] < 0:
        raise InvalidParameter(f"times: got {cuts!r} s, expected at least two, growing, from 0 on")
    state: Any = None
    memory: Any = None
    if cuts[0] > 0:
        lead = segments(
            action, stroke, [Segment(0.0, cuts[0])], (), (), directions=None, rtol=rtol, jobs=1
        )[0]
        state, memory = lead.end_state, lead.end_memory
    out = []
    for a, b in itertools.pairwise(cuts):
        out.append(Segment(a, b, state, memory))
        if b < cuts[-1]:
            part = segments(action, stroke, [out[-1]], (), (), directions=None, rtol=rtol, jobs=1)
            state, memory = part[0].end_state, part[0].end_memory
    return out


def _positive(jobs: int) -> int:
    if int(jobs) < 1:
        raise InvalidParameter(f"jobs = {jobs}, must be >= 1")
    return int(jobs)


def _directions(action: Action, given: Any) -> tuple[tuple[str, ...], Any]:
    import numpy as np

    names = state_names(action)
    n = len(action.coordinates)
    if given is None:
        return (), np.zeros((len(names), 0))
    if isinstance(given, str) or (
        isinstance(given, Sequence) and all(isinstance(g, str) for g in given)
    ):
        if given == "mechanical":
            chosen = names[: 2 * n]
        elif given == "all":
            chosen = names
        else:
            chosen = (given,) if isinstance(given, str) else tuple(given)
        matrix = np.zeros((len(names), len(chosen)))
        for j, name in enumerate(chosen):
            matrix[place_of(name, names, "state"), j] = 1.0
        return chosen, matrix
    matrix = np.asarray(given, dtype=float)
    if matrix.ndim != 2 or matrix.shape[0] != len(names) or not np.all(np.isfinite(matrix)):
        raise InvalidParameter(
            f"directions: got an array of shape {matrix.shape}, expected finite numbers "
            f"({len(names)}, n_directions)"
        )
    return tuple(f"direction{j + 1}" for j in range(matrix.shape[1])), matrix


def _state_unit(action: Action, name: str) -> str:
    n = len(action.coordinates)
    names = state_names(action)
    if name not in names:
        return "1"
    i = names.index(name)
    units: list[str] = action.mechanism.coordinate_units
    if i < 2 * n:
        return units[i % n] + ("/s" if i >= n else "")
    if i < 2 * n + action.mechanism.total_law_states:
        return "SI"
    return "m kg^0.5/s" if name.endswith(".rate") else "m kg^0.5"


def _segment(action: Action, segment: Segment, matrix: Any) -> Any:
    import numpy as np

    size = len(state_names(action))
    contacts = len(action.mechanism.contact_numbers)
    if not isinstance(segment, Segment):
        raise InvalidParameter(
            f"segments: got a {type(segment).__name__}, expected Segment objects"
        )
    state = [] if segment.state is None else np.asarray(segment.state, dtype=float).ravel().tolist()
    memory = (
        [] if segment.memory is None else np.asarray(segment.memory, dtype=float).ravel().tolist()
    )
    for what, values, wanted in (("state", state, size), ("memory", memory, contacts)):
        if values and (len(values) != wanted or not all(map(math.isfinite, values))):
            raise InvalidParameter(
                f"segment from {segment.begin:g} s: {what} holds {len(values)} numbers, expected "
                f"{wanted}, all finite"
            )
    return _core.SensitivitySegment(float(segment.begin), float(segment.end), state, memory, matrix)


def _observables(action: Action) -> list[tuple[str, str, str]]:
    return list(_core.observables(action.mechanism))


def _choose_outputs(
    action: Action, infos: Mapping[str, tuple[int, str]], given: Iterable[str] | None
) -> list[str]:
    if given is not None:
        chosen = [given] if isinstance(given, str) else list(given)
        faults = []
        for name in chosen:
            try:
                place_of(name, list(infos), "output")
            except InvalidParameter as error:
                faults.append(str(error))
        if faults:
            raise InvalidParameter("\n".join(faults))
        return list(dict.fromkeys(chosen))
    points = tuple(action.config.points)
    return [
        name
        for name in infos
        if name in action.coordinates
        or name.rpartition(".")[0] in points
        or name.endswith((".force", ".compression"))
    ]


def _to_gradient(
    result: Any,
    segment: Segment,
    names: list[str],
    infos: Mapping[str, tuple[int, str]],
    chosen: list[Parameter],
    columns: tuple[str, ...],
    units: tuple[str, ...],
    provenance: dict[str, Any],
    sum_up: Callable[[Any], Summary],
    doubts: tuple[str, ...],
) -> Gradient:
    import numpy as np

    run = result.run
    if run.status != "done":
        where = f"segment from {segment.begin:g} s to {segment.end:g} s: "
        raise IntegrationError(
            where + run.message,
            code=run.code,
            partial=None,  # only the derivatives were needed
            time=run.reached,
            state=run.failed_state,
            contact=run.failed_contact,
        )
    summed = sum_up(result)
    stats: dict[str, Any] = {
        "stroke": dict(run.counts),
        **result.counts,
        "wall_stroke": result.wall_stroke,
        "wall": result.wall,
        "warnings": list(doubts),
    }
    return Gradient(
        time=result.time,
        outputs=tuple(names),
        output_units=tuple(infos[n][1] for n in names),
        values=result.values,
        columns=columns,
        column_units=units,
        parameters=tuple(chosen),
        array=np.asarray(result.gradient),
        summary=summed.values,
        summary_gradient=summed.derivatives,
        summary_units=summed.units,
        unknown=summed.unknown,
        events=tuple(summed.events),
        end_state=run.end_state,
        end_memory=np.asarray(run.end_largest_compression),
        end_gradient=result.end_state,
        end_memory_gradient=result.end_memory,
        stats=stats,
        provenance=provenance,
    )
