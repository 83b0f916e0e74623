"""A diagnosis that somebody else stored is repeated, and the answers are compared."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from unmodeled.apart import run_apart, serve
from unmodeled.arguments import checked
from unmodeled.data import Record, read_record
from unmodeled.diagnosis import diagnose
from unmodeled.errors import DataError, InvalidParameter, ModelError, shortened, shown
from unmodeled.files import beside, is_file, is_folder, read_json
from unmodeled.fit import fmu, mujoco
from unmodeled.fit.inclusion import including
from unmodeled.fit.mjcf_parts import MJCF, parts_of
from unmodeled.fit.simulator import Simulator
from unmodeled.library.defaults import chosen_effects
from unmodeled.loading import LoadedModel, load_model
from unmodeled.models.model import Candidate, Effect, Model, Parameter
from unmodeled.report.case import OF_EFFECT, file_and_name, sha256_of, versions
from unmodeled.report.stored import Answer, Stored, StoredCandidate, StoredModel
from unmodeled.report.values import as_made, made
from unmodeled.search.options import Options
from unmodeled.search.progress import Progress
from unmodeled.search.records import ready_records
from unmodeled.units.quantity import fault_text, validated

#: Largest number of values inside one another in a JSON file.
DEEPEST = 50
#: Two numbers agree if they differ by less than this share of their 95 % interval, or of the
#: larger one: far below what an answer means, and above the rounding of other processors.
OF_INTERVAL, OF_VALUE = 0.02, 1e-3
#: Probabilities agree if they differ by less than this [1].
OF_PROBABILITY = 0.01


@dataclass(frozen=True)
class Repeated:
    """A number or a text of an answer, and of its repetition."""

    what: str
    unit: str
    stored: float | str | None
    again: float | str | None
    """None: the answer does not have it."""
    agrees: bool


@dataclass(frozen=True, eq=False)
class Verification:
    """A repeated diagnosis beside the stored one."""

    rows: tuple[Repeated, ...]
    """Files that changed, or else all numbers."""
    notes: tuple[str, ...]
    """Other versions, and why the answers may differ."""
    answer: Mapping[str, Any] | None
    """The repeated answer as in report.json; None: nothing was run, because a file changed."""

    @property
    def agrees(self) -> bool:
        """Whether all files, texts and numbers agree."""
        return self.answer is not None and all(r.agrees for r in self.rows)

    def __str__(self) -> str:
        wrong = [r for r in self.rows if not r.agrees]
        count = f"{len(self.rows) - len(wrong)} of {len(self.rows)} words and numbers agree"
        head = "The answer is the same" if self.agrees else "The answer is another one"
        if self.answer is None:
            head, count = "Nothing was run", "files are not those of the case"
        lines = [f"{head}: {count}."]
        lines += [
            f"- {r.what}: {_told(r.stored, r.unit)} in the case, {_told(r.again, r.unit)} now"
            for r in wrong
        ]
        return "\n".join([*lines, *(f"note: {n}" for n in self.notes)])


def _told(value: float | str | None, unit: str) -> str:
    if value is None:
        return "nothing"
    return f"{value:.6g}{'' if unit == '1' else f' {unit}'}" if isinstance(value, float) else value


@checked
def verify(
    folder: str | Path,
    *,
    model: str = "",
    seconds: float | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Verification:
    """Repeat the diagnosis of a folder that :meth:`Report.write` wrote, and compare the answers.

    Two numbers agree if they differ by less than 2 % of their 95 % interval or 0.1 % of the larger
    one, probabilities if they differ by less than 0.01. All files that are read are in the folder
    and have the hashes of the case; if one has not, nothing is run. The code of a Python model or
    of an FMU is executed, in a process of its own but with your rights: only repeat cases that you
    trust.

    Parameters
    ----------
    folder
        The folder.
    model
        Model instead of the stored one, as for :func:`load_model`, such as ``model.py:cart``;
        default: the stored one. It gets the stored priors.
    seconds
        Limit of time [s]; default: that of the case.
    progress
        As for :func:`unmodeled.diagnose`.

    Raises
    ------
    DataError
        The folder holds no case, a file of it is missing, or case.json or report.json is damaged.
    InvalidParameter
        The model is not stored and not given, or it does not have the parameters or the candidates
        of the case.
    ModelError
        The process of the model ended without an answer.
    """
    folder = Path(folder)
    case = _opened(folder, given=bool(model))
    stored = validated(Answer, _no_nesting(folder / "report.json"), "report.json", DataError)
    changed = tuple(
        Repeated(f"file {name}", "1", "the stored hash", "changed", agrees=False)
        for name, digest in case.sha256.items()
        if sha256_of(folder / name) != digest
    )
    if changed:
        return Verification(changed, (), None)
    asked = {"folder": str(folder), "model": model, "seconds": seconds}
    raw = run_apart("unmodeled.verification", asked, progress)
    again = validated(Answer, raw, "the answer of the model's process", ModelError)
    rows = _compared(stored.model_dump(), again.model_dump())
    return Verification(tuple(rows), tuple(_notes(case, stored, again)), raw)


def repeat(asked: Mapping[str, Any], progress: Callable[[Progress], None] | None) -> dict[str, Any]:
    """The answer of a repeated diagnosis, as :meth:`Report.as_dict`; runs in the other process."""
    folder = Path(asked["folder"])
    case = _opened(folder, given=bool(asked["model"]))
    records = tuple(
        read_record(folder / r.file, inputs=r.inputs, outputs=r.outputs) for r in case.records
    )
    loaded, effects = _model_again(folder, case, asked["model"], records)
    options: Options = made("case.json: options", _options, case.options)
    if asked["seconds"] is not None:
        options = replace(options, seconds=asked["seconds"])
    hold_out = made("case.json: hold_out", as_made, case.hold_out)
    report = diagnose(
        loaded, effects, records, hold_out=hold_out, options=options, progress=progress
    )
    return report.as_dict()


def _no_nesting(path: Path) -> Any:
    """Content of a JSON file; a DataError if its values are nested very deeply."""
    content = read_json(path)
    todo = [(content, 0)]
    while todo:
        value, depth = todo.pop()
        if depth > DEEPEST:
            raise DataError(f"{path}: more than {DEEPEST} values are inside one another")
        inner = value.values() if isinstance(value, dict) else value
        todo += [(v, depth + 1) for v in inner] if isinstance(value, dict | list) else []
    return content


def _faults_of_files(folder: Path, case: Stored, *, given: bool) -> Iterator[str]:
    """Files that are missing, outside, or not listed."""
    records = [Path(r.file) for r in case.records]
    tables = [p.with_suffix(".toml") for p in records if p.name]
    needed = [p.as_posix() for p in (*records, *(t for t in tables if is_file(folder / t)))]
    needed += [] if given or not case.model.file else [case.model.file]
    for name in dict.fromkeys([*case.sha256, *needed, "report.json"]):
        try:
            there = is_file(beside(folder, name, "case.json"))
        except InvalidParameter:
            yield f"{shortened(name)} is outside of the folder"
            continue
        if not there:
            yield f"{shortened(name)} is missing"
        if name not in case.sha256:
            yield f"{shortened(name)} has no hash in case.json"
    for path in () if given else (folder / "model").rglob("*"):
        name = path.relative_to(folder).as_posix()
        if not is_folder(path) and name not in case.sha256:
            yield f"{shortened(name)} is no file of the case: remove it"


def _opened(folder: Path, *, given: bool) -> Stored:
    """case.json of a folder whose files are all there; all that are read are listed in it.

    ``given``: the user gives the model, so that the stored one is not read.
    """
    path = folder / "case.json"
    if not is_file(path):
        raise DataError(
            f"{folder}: holds no case.json, expected a folder that report.write or "
            "unmodeled diagnose --out wrote"
        )
    case = validated(Stored, _no_nesting(path), str(path), DataError)
    faults = [*_faults_of_files(folder, case, given=given)]
    if not faults and not given and Path(case.model.file).suffix.lower() in MJCF:
        faults = _strange_parts(folder, case)
    if faults:
        raise DataError(fault_text(str(folder), faults))
    return case


def _strange_parts(folder: Path, case: Stored) -> list[str]:
    """Files that the stored MuJoCo model names, but that are not files of the case."""
    known = {(folder / name).resolve() for name in case.sha256}
    parts = parts_of(folder / case.model.file).sizes
    return [
        f"{case.model.file} names {p}, which is no file of the case; give the model by --model (in "
        "Python model=)"
        for p in parts
        if p.resolve() not in known
    ]


def _with_priors(folder: Path, model: Model, priors: Sequence[Parameter]) -> Model:
    """A model with the stored priors of all its parameters."""
    own = {p.name: p for p in model.parameters}
    if sorted(own) != sorted(p.name for p in priors):
        raise InvalidParameter(
            f"{folder}: the model {model.name} has the parameters {', '.join(own) or 'none'}, the "
            f"case {', '.join(p.name for p in priors) or 'none'}: expected the same ones"
        )
    other = {p.name: p for p in priors if p != own[p.name]}
    return model.with_parameters(other) if other else model


def _model_again(
    folder: Path, case: Stored, given: str, records: Sequence[Record]
) -> tuple[Model, tuple[Effect, ...]]:
    """Model and candidates of a case, with the stored priors."""
    priors = [made("case.json: parameters", _prior, p) for p in case.model.parameters]
    loaded = _loaded(folder, case.model, priors, given)
    base = loaded.model
    pool = {e.name: e for e in loaded.with_records(records).effects}
    wanted = [c.name for c in case.candidates]
    shapes = {i.effect: i.shape for i in case.model.included}
    if {*wanted, *shapes} - pool.keys():
        ready = ready_records(base, records)
        pool = {e.name: e for e in chosen_effects(ready.model, ready.records, None, ())[0]} | pool
    if missing := [n for n in (*wanted, *shapes) if n not in pool]:
        raise InvalidParameter(
            f"{folder}: no effect {', '.join(missing)} is known for the model {base.name}; let a "
            "Python file define it as one of its effects, and name the file by --model (in Python "
            "model=)"
        )
    model = base
    if shapes:
        included = [made("case.json: included", _candidate, pool[n], s) for n, s in shapes.items()]
        model = including(base, included)
    return _with_priors(folder, model, priors), tuple(
        made(f"case.json: candidate {c.name}", _disputed, pool[c.name], c) for c in case.candidates
    )


def _options(stored: Mapping[str, Any]) -> Options:
    return Options(**as_made(stored))


def _candidate(effect: Effect, shape: Any) -> Candidate:
    return Candidate(effect, as_made(shape))


def _prior(stored: Mapping[str, Any]) -> Parameter:
    parameter = as_made(stored)
    if not isinstance(parameter, Parameter):
        raise DataError(f"got {shown(stored)}, expected a Parameter")
    return parameter


def _disputed(effect: Effect, stored: StoredCandidate) -> Effect:
    """An effect with the numbers of case.json."""
    given = stored.model_dump(include=set(OF_EFFECT) & stored.model_fields_set)
    return replace(effect, **{k: as_made(v) for k, v in given.items()})


def _loaded(
    folder: Path, stored: StoredModel, priors: Sequence[Parameter], given: str
) -> LoadedModel:
    """The model as it was made, from its copy or from what is given instead."""
    kind, file = stored.made_by, stored.file
    included = [i.effect for i in stored.included]
    parameters = [p for p in priors if p.name not in included]
    name = given or (str(folder / file) if file else "")
    name += f":{stored.object}" if file and not given and stored.object else ""
    name = name or stored.object
    if not name:
        raise InvalidParameter(
            f"{folder}: its model {stored.name} is not stored, because no file holds it; name "
            "one by --model FILE.py:NAME (in Python model=)"
        )
    arguments = made("case.json: arguments", as_made, stored.arguments)
    if kind in ("fmu", "mujoco") and not file_and_name(name)[1]:
        make = fmu if kind == "fmu" else mujoco
        model = made("case.json: arguments", make, name, parameters=parameters, **arguments)
        return LoadedModel(model, default=True)
    given_to = arguments if kind == "load_model" else {}
    loaded = made("case.json: arguments", load_model, name, **given_to)
    if kind == "Simulator" and isinstance(loaded.model, Simulator):
        function = loaded.model.function
        model = made(
            "case.json: arguments",
            Simulator,
            function,
            parameters=parameters,
            **arguments,
        )
        return replace(loaded, model=model)
    return loaded


def _notes(case: Stored, stored: Answer, again: Answer) -> Iterator[str]:
    """Why answers may differ."""
    before, now = case.made_with, versions()
    for name in sorted({*before, *now} - {"code"}):
        if before.get(name) != now.get(name):
            yield f"{name} {before.get(name, 'none')} in the case, {now.get(name, 'none')} here"
    if before.get("unmodeled") == now["unmodeled"] and before.get("code") != now["code"]:
        yield "unmodeled has another code than that of the case, with the same version"
    if not (again.complete and stored.complete):
        which = "the repeated" if stored.complete else "the stored"
        yield f"{which} search ended at its limit of time: answers then depend on the processor"


_Pair = tuple[Mapping[str, Any] | None, Mapping[str, Any] | None]


def _pairs(
    stored: Iterable[Mapping[str, Any]], again: Iterable[Mapping[str, Any]], key: str = "name"
) -> Iterator[tuple[str, _Pair, str]]:
    """Name, rows and unit of what has one name in two tables, or stands in one of them."""
    one, other = ({row[key]: row for row in table} for table in (stored, again))
    for name, row in (one | {n: r for n, r in other.items() if n not in one}).items():
        yield name, (one.get(name), other.get(name)), row["unit"]


def _both(pair: _Pair, what: str) -> list[Any]:
    return [None if row is None else row[what] for row in pair]


def _interval_rows(title: str, pair: _Pair, unit: str, value: str) -> Iterator[Repeated]:
    width = max(row["high"] - row["low"] for row in pair if row is not None)
    for what, more in ((value, ""), ("low", ", low"), ("high", ", high")):
        yield _number_row(f"{title}{more}", unit, _both(pair, what), OF_INTERVAL * width)


def _compared(stored: Mapping[str, Any], again: Mapping[str, Any]) -> Iterator[Repeated]:
    """The numbers of two answers, in the order of a report."""
    yield _text_row("verdict", stored["verdict"], again["verdict"])
    for what, key in (("named causes", "named"), ("classes", "classes")):
        yield _text_row(what, *(_causes(r[key]) for r in (stored, again)))
    named, parameters = (
        (_listed(stored, table), _listed(again, table)) for table in ("named", "parameters")
    )
    for name, pair, unit in _pairs(*named, key="cause"):
        yield from _interval_rows(name, pair, unit, "magnitude")
        yield _number_row(f"{name}, probability", "1", _both(pair, "probability"), OF_PROBABILITY)
    for name, pair, unit in _pairs(*parameters):
        yield from _interval_rows(f"parameter {name}", pair, unit, "value")
    for name, pair, unit in _pairs(stored["channels"], again["channels"]):
        for what in ("tabulated", "calibrated", "explained", "noise"):
            yield _number_row(f"residual of {name}, {what}", unit, _both(pair, what), 0.0)
    values = [r["nothing"] for r in (stored, again)]
    yield _number_row("no cause is missing, probability", "1", values, OF_PROBABILITY)
    gains = [None if (g := r["held_out_gain"]) is None else g[0] for r in (stored, again)]
    yield _number_row("held-out residual with the causes, share", "1", gains, OF_PROBABILITY)


def _listed(answer: Mapping[str, Any], table: str) -> list[dict[str, Any]]:
    """Rows of a table of an answer; those of classes are told beside the named causes."""
    more = [n for group in answer["classes"] for n in group] if table == "named" else []
    return [*answer[table], *more]


def _causes(found: Sequence[Any]) -> str:
    names = [f"({_causes(n)})" if isinstance(n, list) else n["cause"] for n in found]
    return ", ".join(sorted(names)) or "none"


def _text_row(what: str, one: str, other: str) -> Repeated:
    return Repeated(what, "1", one, other, one == other)


def _number_row(what: str, unit: str, values: Sequence[float | None], permitted: float) -> Repeated:
    one, other = values
    if one is None or other is None:
        return Repeated(what, unit, one, other, one is other)
    same = one == other or (math.isnan(one) and math.isnan(other))
    permitted = (permitted if math.isfinite(permitted) else 0.0) + OF_VALUE * max(
        abs(one), abs(other)
    )
    return Repeated(what, unit, one, other, same or abs(one - other) <= permitted)


if __name__ == "__main__":
    serve(repeat)
