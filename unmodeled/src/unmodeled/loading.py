"""Models from files and from extensions, with the effects that are tested."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from types import FunctionType
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter

if TYPE_CHECKING:
    from unmodeled.data import Array, ReadOptions, Record, Sensor
    from unmodeled.data.mapping import Signals
    from unmodeled.data.robots import Tell
    from unmodeled.fit import Effect, Model

#: Group of the entry points of extensions.
GROUP = "unmodeled.models"


class Extension(Protocol):
    """What an entry point of the group ``unmodeled.models`` names: a module with these functions.

    A package that has such an entry point adds its own kind of models to :func:`load_model` and to
    the command line.
    """

    def load(
        self,
        name: str,
        settings: Mapping[str, str],
        channels: Sequence[str],
        notify: Callable[[str], None] | None,
    ) -> LoadedModel | None:
        """Model of a name or a file; None: it is not of this kind."""

    def names(self) -> Iterable[str]:
        """Names of the models that it knows without a file."""

    def settings(self, words: Sequence[str], incomplete: str) -> Iterable[str]:
        """Completions of a setting ``NAME=VALUE``, from the words of the command line."""


@cache
def extensions() -> tuple[Extension, ...]:
    """Installed extensions."""
    return tuple(e.load() for e in entry_points(group=GROUP))


@dataclass(frozen=True)
class LoadedModel:
    """A model with the effects that are tested."""

    model: Model
    effects: tuple[Effect, ...] = ()
    planned: tuple[Record, ...] = ()
    """Possible runs, for ``unmodeled plan``."""
    outputs_of: Callable[[Sequence[str]], tuple[str, ...]] = tuple
    """Function that returns the outputs of named channels."""
    made: Callable[[Sequence[Record]], Sequence[Effect]] | None = None
    """Function that makes the effects from the records; None: ``effects`` are all."""
    default: bool = False
    """Whether the effects are the default ones, :func:`unmodeled.candidates`."""
    tell: Tell | None = None
    """Function that gets the table of what the signals of a log of a robot became."""

    @property
    def signals(self) -> Signals:
        """Possible signals of the columns of a measured file."""
        from unmodeled.data.mapping import Signals

        return Signals.of(self.model, self.tell)

    def read(self, data: Sequence[Path], options: ReadOptions | None = None) -> tuple[Record, ...]:
        """Read measured files as records of the model."""
        return tuple(r for group in self.read_each(data, options) for r in group)

    def read_each(
        self, data: Sequence[Path], options: ReadOptions | None = None
    ) -> tuple[tuple[Record, ...], ...]:
        """Read records by file; a file may contain several runs."""
        from unmodeled.data.files import read_each

        return read_each(data, self.signals, options)

    def _sensors(
        self, model: Model, records: Sequence[Record], channels: Sequence[str]
    ) -> dict[str, Sensor]:
        """Sensors of records that could be made, by output; see :meth:`read_proposed`."""
        from unmodeled.data import Sensor

        sensors = [s for r in records for s in r.sensors.items()]
        known = {n: s for n, s in sensors if n in model.outputs}
        wanted = self.outputs_of(channels) if channels else ()
        for name in wanted or (() if known else model.outputs):
            known.setdefault(name, Sensor(name=name, unit=model.units.get(name, "1")))
        return known

    def read_proposed(
        self,
        files: Sequence[Path],
        records: Sequence[Record] = (),
        channels: Sequence[str] = (),
        options: ReadOptions | None = None,
    ) -> tuple[Record, ...]:
        """Records that could be made: files with a time and inputs, or the planned runs.

        A file without outputs gets the sensors of the measured ``records``, else of the planned
        runs, else all outputs of the model; ``channels``: those that are measured in addition, or
        alone if there are neither records nor planned runs.

        Raises
        ------
        DataError
            A file cannot be read.
        InvalidParameter
            There is neither a file nor a planned run.
        """
        from unmodeled.data.files import read_each
        from unmodeled.search.records import ready_records

        if not files and not self.planned:
            raise InvalidParameter(
                f"{self.model.name}: has no planned runs; give files with a time and inputs"
            )
        model = ready_records(self.model, records).model if records else self.model
        signals = replace(self, model=model).signals
        known = self._sensors(model, records or self.planned, channels)
        if not files:
            return tuple(_measured_by(r, known) for r in self.planned)
        inputs = (*signals.inputs, *(n for names in signals.modes.values() for n in names))
        # An input column counts as an output too, because a file without outputs is no record.
        outputs = () if signals.any_inputs else (*signals.outputs, *inputs)
        read = [r for g in read_each(files, replace(signals, outputs=outputs), options) for r in g]
        if not model.outputs:  # a function: its outputs are among the columns
            return tuple(read)
        return tuple(_proposed(r, model.outputs, known, any_inputs=not outputs) for r in read)

    def with_records(self, records: Sequence[Record], exclude: Sequence[str] = ()) -> LoadedModel:
        """Copy whose effects are made from these records, or from planned ones.

        ``exclude``: names, patterns or components of effects that are left out.

        Raises
        ------
        InvalidParameter
            There is no record, or the function of the effects fails.
        """
        from unmodeled.library.defaults import chosen_effects
        from unmodeled.ode.calling import calling
        from unmodeled.search.records import ready_records

        records = tuple(records) or self.planned
        if self.made is None and not self.default:
            kept, _ = chosen_effects(self.model, records, self.effects, exclude)
            return replace(self, effects=kept)
        if not records:
            raise InvalidParameter(
                f"model {self.model.name}: its effects are a function of the records; give "
                "measured files, or define planned records"
            )
        if self.made is None:
            ready = ready_records(self.model, records)
            kept, _ = chosen_effects(ready.model, ready.records, None, exclude)
            return replace(self, model=ready.model, effects=kept, default=False)
        with calling(f"model {self.model.name}: effects(records)"):
            effects, fault = _listed(self.made(records))
        if fault:
            raise InvalidParameter(f"model {self.model.name}: effects(records) {fault}")
        return replace(self, effects=effects, made=None).with_records(records, exclude)

    def measured(self, path: Path | None) -> LoadedModel:
        """Copy with tests of single parts instead of tolerances."""
        from unmodeled.fit.measured import read_measured, with_measured

        if path is None:
            return self
        tests = read_measured(path, self.model, self.effects)
        return replace(self, model=with_measured(self.model, tests, self.effects))

    def including(self, names: Sequence[str]) -> LoadedModel:
        """Copy whose model includes effects of the library."""
        from unmodeled.fit import including

        names = list(dict.fromkeys(names))
        if not names:
            return self
        known = {e.name: e for e in self.effects}
        unknown = [n for n in names if n not in known]
        if unknown:
            raise InvalidParameter(
                f"--include {', '.join(unknown)}: no such effect; there are {', '.join(known)}"
            )
        return replace(
            self,
            model=including(self.model, [known[n] for n in names]),
            effects=tuple(e for e in known.values() if e.name not in names),
        )


def _measured_by(
    record: Record, sensors: Mapping[str, Sensor], inputs: Mapping[str, Array] | None = None
) -> Record:
    """A planned record with other sensors, and with other inputs if they are given."""
    outputs = {n: np.zeros(record.samples) for n in sensors}
    return replace(record, inputs=inputs or record.inputs, outputs=outputs, sensors=dict(sensors))


def _proposed(
    record: Record, outputs: Collection[str], known: Mapping[str, Sensor], *, any_inputs: bool
) -> Record:
    """A record that could be made, from a file; ``any_inputs``: its other columns are inputs."""
    other = {n: v for n, v in record.outputs.items() if any_inputs and n not in outputs}
    sensors = {n: s for n, s in record.sensors.items() if n in outputs} or known
    return _measured_by(record, sensors, {**other, **record.inputs})


@checked
def load_model(
    name: str,
    settings: Mapping[str, str] | None = None,
    channels: Sequence[str] = (),
    *,
    parameters: Mapping[str, Any] | None = None,
    unknown: Mapping[str, Any] | None = None,
    running: Mapping[str, Any] | None = None,
    notify: Callable[[str], None] | None = None,
) -> LoadedModel:
    """Model by the path of a file, or by a name that an extension knows.

    The file is an FMU, a MuJoCo model (XML), Python, or a file of an extension. A Python file
    defines ``model``, or another name behind a colon: an :class:`unmodeled.Model`, or a function
    ``(time, inputs, parameters) -> {output: values}``. It may define ``effects`` (a sequence of
    :class:`unmodeled.Effect`, or a function of the records that returns one, see
    :meth:`LoadedModel.with_records`) and ``planned`` (possible records). The file is executed: only
    use files that you trust.

    Parameters
    ----------
    name
        Path of the file, or name.
    settings
        Settings of a model of an extension, by name.
    channels
        Channels of a model of an extension that are required in addition to its default ones.
    parameters, unknown
        As for :class:`unmodeled.Simulator`, for functions, FMUs and MuJoCo models.
    running
        Further arguments of :func:`unmodeled.mujoco` (``key``, ``settle``, ``hold``) or
        :func:`unmodeled.fmu` (``hold``).
    notify
        Function that receives sentences about assumptions.

    Raises
    ------
    InvalidParameter
        There is no such model, or an argument does not belong to its kind.

    Examples
    --------
    A Python file with a function:

    >>> import tempfile
    >>> from pathlib import Path
    >>> import unmodeled
    >>> file = Path(tempfile.mkdtemp()) / "rig.py"
    >>> _ = file.write_text("def line(time, inputs, p): return {'x': p['gain'] * inputs['F']}")
    >>> unmodeled.load_model(f"{file}:line", parameters={"gain": (2.0, 0.1, "m/N")}).model.name
    'line'
    """
    from unmodeled.fit import fmu, mujoco
    from unmodeled.fit.mjcf_parts import MJCF
    from unmodeled.models.model import Origin

    parameters, unknown, running = parameters or {}, unknown or {}, running or {}
    stem, _, attribute = name.partition(".py:")
    path = Path(f"{stem}.py" if attribute else name)
    kind = path.suffix.lower()
    if settings and kind in (".py", ".fmu", *MJCF):
        raise InvalidParameter(f"{name}: has no settings (--set), because it is a {kind} file")
    _check_running(
        name, running, ("key", "settle", "hold") if kind in MJCF else ("hold",) * (kind == ".fmu")
    )
    if kind == ".py":
        return _from_file(path, attribute, parameters, unknown)
    if kind in (".fmu", *MJCF):
        make = fmu if kind == ".fmu" else mujoco
        model = make(path, parameters=parameters, unknown=unknown or None, **running)
        return LoadedModel(model, default=True)
    settings = dict(settings or {})
    for extension in extensions():
        loaded = extension.load(name, settings, channels, notify)
        if loaded is None:
            continue
        given = {"settings": settings, "channels": tuple(channels)}
        loaded.model.origin = Origin("load_model", name, given)
        if parameters or unknown:
            raise InvalidParameter(
                f"{name}: has its own parameters; --set changes their values, instead of "
                "--parameter and --unknown"
            )
        return loaded
    raise InvalidParameter(_no_model(name, kind))


def _check_running(name: str, running: Iterable[str], known: Sequence[str]) -> None:
    if wrong := [f"--{n}" for n in running if n not in known]:
        raise InvalidParameter(
            f"{name}: got {', '.join(wrong)}, which belongs to a MuJoCo model"
            f"{' or an FMU' if '--hold' in wrong else ''}"
        )


def _no_model(name: str, kind: str) -> str:
    from unmodeled.data.columns import MEASURED_FILES

    measured = kind in MEASURED_FILES
    hint = "; this is a file of data, the model is the first argument" if measured else ""
    others = [n for e in extensions() for n in e.names()]
    known = f", or one of {', '.join(others)}" if others else ""
    return (
        f"no model {name!r}; expected a Python file (model.py:FUNCTION), an FMU, a MuJoCo model "
        f"(.xml){known}{hint}"
    )


def _from_file(
    path: Path,
    attribute: str,
    parameters: Mapping[str, tuple[float | None, float, str]],
    unknown: Mapping[str, Any],
) -> LoadedModel:
    """Model, effects and planned runs of a Python file."""
    from unmodeled.fit import Model
    from unmodeled.models.model import Origin
    from unmodeled.ode.calling import calling

    names = _executed(path)
    defined = names.get(attribute or "model")
    model = _model_of(path, names, attribute or "model", parameters, unknown)
    given = names.get("effects")
    made = given if callable(given) else None
    with calling(f"{path}: effects"):
        effects, fault = ((), "") if made or given is None else _listed(given)
    faults = [] if isinstance(model, Model) else [model]
    faults += [f"effects {fault}"] if fault else []
    if faults:
        raise InvalidParameter(f"{path}: " + "; ".join(map(str, faults)))
    assert isinstance(model, Model)
    place, origin = f"{path.absolute()}:{attribute or 'model'}", model.origin
    if origin is not None and origin.made_by == "Simulator" and not isinstance(defined, Model):
        model.origin = replace(origin, name=place)
    elif origin is None or origin.made_by == "Simulator" or given is not None:
        model.origin = Origin("load_model", place)
    planned = tuple(names.get("planned", ()))
    return LoadedModel(model, effects, planned, made=made, default=given is None)


def _executed(path: Path) -> dict[str, Any]:
    """Names that a Python file defines."""
    from unmodeled.files import is_file

    if not is_file(path):
        raise InvalidParameter(f"{path}: there is no such file")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    folder = str(path.absolute().parent)
    if folder not in sys.path:
        sys.path.append(folder)  # modules beside the file, as when Python runs it
    try:
        spec.loader.exec_module(module)
    except SystemExit as error:
        raise InvalidParameter(
            f"{path}: ends the program (exit code {error.code!r}), expected it to define a model"
        ) from None
    except Exception as error:
        raise InvalidParameter(f"{path}: {type(error).__name__}: {error}") from error
    return vars(module)


def _model_of(
    path: Path,
    names: Mapping[str, Any],
    wanted: str,
    parameters: Mapping[str, tuple[float | None, float, str]],
    unknown: Mapping[str, Any],
) -> Model | str:
    """Model of a Python file, or why there is none."""
    from unmodeled.fit import Model, Simulator

    model = names.get(wanted)
    if callable(model) and not isinstance(model, (Model, type)):
        return Simulator(model, parameters=parameters, unknown=unknown)
    if model is not None and (parameters or unknown):
        raise InvalidParameter(
            f"{path}: --parameter and --unknown describe a function; {wanted} is "
            f"{type(model).__name__}, which has its own"
        )
    if isinstance(model, Model):
        return model
    if model is not None:
        return f"{wanted} is {type(model).__name__}, expected an unmodeled.Model or a function"
    others = [n for n, v in names.items()
              if isinstance(v, (Model, FunctionType)) and not n.startswith("_")]  # fmt: skip
    hint = f"; there is {path.name}:{f', {path.name}:'.join(others)}" if others else ""
    return f"{wanted} is missing, expected a model or a function with this name{hint}"


def _listed(given: object) -> tuple[tuple[Effect, ...], str]:
    """Effects as a tuple, and why something is no sequence of effects; empty: it is one."""
    from unmodeled.fit import Effect

    if not isinstance(given, Iterable):
        return (), f"is {type(given).__name__}, expected a sequence of unmodeled.Effect"
    effects = tuple(given)
    if not all(isinstance(e, Effect) for e in effects):
        return (), "holds something that is no unmodeled.Effect"
    return effects, ""
