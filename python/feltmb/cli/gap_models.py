"""Models on the command line: a mechanism, a Python file, an FMU, or a MuJoCo model."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import FunctionType
from typing import TYPE_CHECKING

from feltmb.cli.messages import complain
from feltmb.data import ReadOptions, Record
from feltmb.data.files import read_each
from feltmb.data.mapping import Signals
from feltmb.errors import InvalidParameter
from feltmb.experiment import Limits
from feltmb.files import is_file
from feltmb.fit import Effect, Model, Simulator, fmu, including, mujoco
from feltmb.fit.calling import calling
from feltmb.gap import candidates, read_measured, with_measured

if TYPE_CHECKING:
    from feltmb.run.stroke.strokes import Kind

__all__ = ["Adapter", "Stated", "held_out", "load_adapter"]

#: Endings of files of MuJoCo models.
MJCF = (".xml", ".mjcf", ".urdf")


@dataclass(frozen=True)
class Stated:
    """Parameters of a model and effects that are its parameters, from the command line."""

    parameters: Mapping[str, tuple[float | None, float, str]] = field(default_factory=dict)
    """(value or None, sd, unit) by name."""
    unknown: Mapping[str, object] = field(default_factory=dict)
    """Unit, or (value without the effect, expected size, unit), by name."""


@dataclass(frozen=True)
class Adapter:
    """A model with the effects that are tested."""

    model: Model
    effects: tuple[Effect, ...] = ()
    planned: tuple[Record, ...] = ()
    """Possible runs, for ``feltmb gap plan``."""
    outputs_of: Callable[[Sequence[str]], tuple[str, ...]] = tuple
    """Function that returns the outputs of named channels."""
    limits: Limits | None = None
    """Limits of experiments, unless a file states others."""
    kinds: Mapping[str, Kind] = field(default_factory=dict)
    """Inputs that are strokes of a mechanism, with the kind of the stroke."""
    made: Callable[[Sequence[Record]], Sequence[Effect]] | None = None
    """Function that makes the effects from the records; None: ``effects`` are all."""
    default: bool = False
    """Whether the effects are the default ones, :func:`feltmb.gap.candidates`."""

    @property
    def signals(self) -> Signals:
        """Possible signals of the columns of a measured file."""
        return Signals(
            inputs=self.model.inputs,
            outputs=self.model.outputs,
            modes=self.model.input_modes,
            units=self.model.units,
            names=self.model.input_names,
            any_inputs=self.model.any_inputs,
        )

    def read(self, data: Sequence[Path], options: ReadOptions | None = None) -> tuple[Record, ...]:
        """Read measured files as records of the model."""
        return tuple(r for group in self.read_each(data, options) for r in group)

    def read_each(
        self, data: Sequence[Path], options: ReadOptions | None = None
    ) -> tuple[tuple[Record, ...], ...]:
        """Read records by file; a file may contain several runs."""
        return read_each(data, self.signals, options)

    def with_records(self, records: Sequence[Record]) -> Adapter:
        """Copy of the adapter whose effects are made from these records, or from planned ones.

        Raises
        ------
        InvalidParameter
            There is no record, or the function of the effects fails.
        """
        if self.made is None and not self.default:
            return self
        records = tuple(records) or self.planned
        if not records:
            raise InvalidParameter(
                f"model {self.model.name}: its effects are a function of the records; give "
                "measured files, or define planned records"
            )
        if self.made is None:
            return replace(self, effects=candidates(self.model, records), default=False)
        with calling(f"model {self.model.name}: effects(records)"):
            effects, fault = _listed(self.made(records))
        if fault:
            raise InvalidParameter(f"model {self.model.name}: effects(records) {fault}")
        return replace(self, effects=effects, made=None)

    def measured(self, path: Path | None) -> Adapter:
        """Copy of the adapter with tests of single parts instead of tolerances."""
        if path is None:
            return self
        tests = read_measured(path, self.model, self.effects)
        return replace(self, model=with_measured(self.model, tests, self.effects))

    def including(self, names: Sequence[str]) -> Adapter:
        """Copy of the adapter whose model includes effects of the library."""
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


def _mechanism(name: str, settings: Mapping[str, str], channels: Sequence[str]) -> Adapter | None:
    """Packaged mechanism or mechanism file, see :mod:`feltmb.adapters.resolve`."""
    from feltmb.adapters import STROKE_KINDS, finger_limits, planned_strokes
    from feltmb.adapters.resolve import resolve

    found = resolve(name, settings, channels, tell=complain)
    if found is None:
        return None
    model, effects = found
    return Adapter(
        model,
        effects,
        planned_strokes(model),
        model.library.outputs,
        finger_limits(model),
        STROKE_KINDS,
    )


def load_adapter(
    name: str,
    settings: Sequence[str] = (),
    channels: Sequence[str] = (),
    stated: Stated | None = None,
) -> Adapter:
    """Adapter by the name of a packaged mechanism, or the path of a file.

    The file is a mechanism (TOML), an FMU, a MuJoCo model (XML), or Python. ``channels`` are
    required in addition to the default channels of a mechanism.

    A Python file defines ``model``, or another name behind a colon: a :class:`feltmb.fit.Model`, or
    a function ``(time, inputs, parameters) -> {output: values}``. It may define ``effects`` (a
    sequence of :class:`feltmb.fit.Effect`, or a function of the records that returns one, see
    :meth:`Adapter.with_records`), ``planned`` (possible records) and ``limits`` (a
    :class:`feltmb.experiment.Limits`). The file is executed: only use files that you trust.
    """
    stated = stated or Stated()
    values = {}
    for text in settings:
        key, mark, value = text.partition("=")
        if not mark:
            raise InvalidParameter(f"--set {text}: expected PATH=VALUE")
        values[key.strip()] = value.strip()
    stem, _, attribute = name.partition(".py:")
    path = Path(f"{stem}.py" if attribute else name)
    kind = path.suffix.lower()
    if values and kind in (".py", ".fmu", *MJCF):
        raise InvalidParameter(f"{name}: --set works with packaged mechanisms, not with a file")
    if kind == ".py":
        return _from_file(path, attribute, stated)
    if kind in (".fmu", *MJCF):
        make = fmu if kind == ".fmu" else mujoco
        model = make(path, parameters=stated.parameters, unknown=stated.unknown or None)
        return Adapter(model, default=True)
    if stated.parameters or stated.unknown:
        raise InvalidParameter(
            f"{name}: a mechanism has its parameters; --set changes their values"
        )
    found = _mechanism(name, values, channels)
    if found is None:
        from feltmb.data.columns import MEASURED_FILES

        measured = path.suffix.lower() in MEASURED_FILES
        hint = "; this is a file of data, the model is the first argument" if measured else ""
        raise InvalidParameter(
            f"no model {name!r}; expected a Python file (model.py:FUNCTION), an FMU, a MuJoCo "
            f"model (.xml), a mechanism file, or a packaged mechanism (feltmb list){hint}"
        )
    return found


def _from_file(path: Path, attribute: str, stated: Stated) -> Adapter:
    if not is_file(path):
        raise InvalidParameter(f"{path}: there is no such file")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except SystemExit as error:
        raise InvalidParameter(
            f"{path}: ends the program (exit code {error.code!r}), expected it to define a model"
        ) from None
    except Exception as error:
        raise InvalidParameter(f"{path}: {type(error).__name__}: {error}") from error
    wanted = attribute or "model"
    model = getattr(module, wanted, None)
    if callable(model) and not isinstance(model, (Model, type)):
        unknown = {
            n: (0.0, *u[1:]) if isinstance(u, tuple) else u for n, u in stated.unknown.items()
        }
        model = Simulator(model, parameters=stated.parameters, unknown=unknown)
    elif stated.parameters or stated.unknown:
        raise InvalidParameter(
            f"{path}: --parameter and --unknown describe a function; {wanted} is "
            f"{type(model).__name__}, which has its own"
        )
    given = getattr(module, "effects", None)
    made = given if callable(given) else None
    with calling(f"{path}: effects"):
        effects, fault = ((), "") if made or given is None else _listed(given)
    faults = []
    if model is None:
        names = [n for n, v in vars(module).items()
                 if isinstance(v, (Model, FunctionType)) and not n.startswith("_")]  # fmt: skip
        hint = f"; there is {path.name}:{f', {path.name}:'.join(names)}" if names else ""
        faults.append(f"{wanted} is missing, expected a model or a function with this name{hint}")
    elif not isinstance(model, Model):
        faults.append(
            f"{wanted} is {type(model).__name__}, expected a feltmb.gap.Model or a function"
        )
    if given is not None and fault:
        faults.append(f"effects {fault}")
    if faults:
        raise InvalidParameter(f"{path}: " + "; ".join(faults))
    assert isinstance(model, Model)
    limits = getattr(module, "limits", None)
    if limits is not None and not isinstance(limits, Limits):
        raise InvalidParameter(
            f"{path}: limits is {type(limits).__name__}, expected a feltmb.experiment.Limits"
        )
    return Adapter(
        model,
        effects,
        tuple(getattr(module, "planned", ())),
        limits=limits,
        made=made,
        default=given is None,
    )


def _listed(given: object) -> tuple[tuple[Effect, ...], str]:
    """Effects as a tuple, and why something is no sequence of effects; empty: it is one."""
    if not isinstance(given, Iterable):
        return (), f"is {type(given).__name__}, expected a sequence of feltmb.gap.Effect"
    effects = tuple(given)
    if not all(isinstance(e, Effect) for e in effects):
        return (), "holds something that is no feltmb.gap.Effect"
    return effects, ""


def held_out(
    given: tuple[str, ...], data: Sequence[Path], groups: Sequence[Sequence[Record]]
) -> list[str]:
    """Names of the held-out records.

    Each is given by its name, by its file, or by the file name; a file means all of its runs.

    Raises
    ------
    InvalidParameter
        A name is ambiguous.
    """
    out: list[str] = []
    for h in given:
        paths = [g for p, g in zip(data, groups, strict=True) if str(p) == h]
        files = [g for p, g in zip(data, groups, strict=True) if p.name == h]
        if not paths and len(files) > 1:
            raise InvalidParameter(
                f"--hold-out {h}: is the name of {len(files)} files; give the whole path of one, "
                "as it stands among the data"
            )
        found = (paths or files or [()])[0]
        out += [r.name for r in found] or [h]
    return out
