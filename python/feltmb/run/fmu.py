"""Mechanisms and felts as co-simulation FMUs that run without Python (FMI 3.0 and 2.0)."""

from __future__ import annotations

import fnmatch
import hashlib
import platform
import re
import sys
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from xml.sax.saxutils import quoteattr

from feltmb import _core
from feltmb.contact import Law
from feltmb.mechanism import Action, LawChoice, core_law, describe, load_action
from feltmb.run.simulate import refuse_kind
from feltmb.run.stroke.strokes import MOTORS, PRESCRIBED, UNITS, Kind
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter
from unmodeled.files import check_suffix, write_file

#: Value references of variables, as in cpp/fmu/unit.hpp.
_TIME, _INPUT, _TOLERANCE, _RATE, _OUTPUTS = 0, 1, 2, 3, 1000
_PEAKS, _STARTS, _PARAMETERS = 50_000, 90_000, 100_000

#: Exponents of kg, m, s, rad by symbol.
_BASE = {
    "kg": (1, 0, 0, 0),
    "m": (0, 1, 0, 0),
    "s": (0, 0, 1, 0),
    "rad": (0, 0, 0, 1),
    "N": (1, 1, -2, 0),
    "J": (1, 2, -2, 0),
    "Pa": (1, -1, -2, 0),
}
_FACTOR = re.compile(r"([A-Za-z]+)(?:\^(\d+))?$")

#: Descriptions of the inputs, for their variables.
_ABOUT = {
    "force": "force of the finger on the mechanism, positive pressing",
    "motion": "motion of a finger that meets its body through its pad; 0 just touches it at rest",
    "key_motion": "motion of the point under the finger, from its rest",
    "torque": "torque of the motor",
    "motor_motion": "motion of the motor's hub, from its rest",
}


@dataclass(frozen=True)
class _Variable:
    name: str
    reference: int
    causality: str
    variability: str
    unit: str
    text: str
    start: float | None = None
    low: float | None = None
    high: float | None = None


@checked
def export_fmu(
    action: Action | str | Path,
    path: str | Path,
    *,
    version: Literal["3.0", "2.0"] = "3.0",
    drive: Kind | None = None,
    hold: Literal["zero", "linear"] | None = None,
    parameters: str | Iterable[str] = "*",
    rtol: float = 1e-6,
    method: str = "auto",
    max_order: int | None = None,
    force: bool = False,
) -> Path:
    """Write a mechanism as a co-simulation FMU for this platform.

    The FMU contains the mechanism and its own binary; it does not need Python. All channels are
    outputs, and the largest force of each contact since the last communication point
    (``contact12.force.peak``). The input is one of the five kinds. The values of the mechanism are
    parameters, and the rest pose follows from them. It starts at rest, unless the parameters
    ``start_offset.COORDINATE`` (distance from the rest pose) or ``start_rate.COORDINATE`` are not
    zero. Its steps are the steps of :class:`feltmb.Machine`.

    Parameters
    ----------
    action
        Object, or name for :func:`load_action`.
    path
        File of the FMU, ``.fmu``.
    version
        Version of FMI.
    drive
        Kind of the input; default: ``"force"``, or ``"torque"`` for a mechanism with a motor.
    hold
        Time function of a force, a torque or a finger's motion within a step. ``"zero"``: constant
        at the value of the input. ``"linear"``: a straight line from the value of the last step to
        the value of the input, which is a delay of one step. Default: linear for a motion, else
        zero. Prescribed motions reach the value at the end of the step.
    parameters
        Names of the values that become parameters, with ``*`` for any part; default: all.
    rtol, method, max_order
        As in :class:`Machine`; ``rtol`` is also a parameter of the FMU.
    force
        Replace an existing file.

    Returns
    -------
    Path
        The written file.

    Raises
    ------
    InvalidParameter
        An argument is out of range, a pattern matches no parameter, the mechanism has no finger or
        motor for the input, or one of its laws is a compiled function.
    FileExists
        The file exists and ``force`` is false.
    """
    path = Path(path)
    check_suffix(path, ".fmu")
    if not isinstance(action, Action):
        action = load_action(action)
    if drive is None:
        drive = "force" if action.config.motor is None else "torque"
    if drive not in UNITS:
        raise InvalidParameter(f"drive {drive!r} is none of {', '.join(UNITS)}")
    refuse_kind(action, drive, f"the input of the unit is a {drive}")
    if hold is None:
        hold = "linear" if drive == "motion" else "zero"
    description = describe(action.config)
    stepper = _core.Stepper(
        action.mechanism,
        drive,
        rtol=rtol,
        method=method,
        max_order=max_order or 0,
        max_step=0.0,
        max_wall=0.0,
        events=False,
        finger_reference=float("nan"),
        monitors=[],
    )
    variables = [_Variable("time", _TIME, "independent", "continuous", "s", "time")]
    about = _ABOUT[drive]
    if drive in MOTORS:
        about += f", coordinate {action.config.motor.coordinate}"  # type: ignore[union-attr]
    how = "at the end of the step" if drive in PRESCRIBED else f"hold: {hold}"
    variables.append(
        _Variable(drive, _INPUT, "input", "continuous", UNITS[drive], f"{about}; {how}", 0.0)
    )
    variables.append(
        _Variable("rtol", _TOLERANCE, "parameter", "fixed", "1", "relative tolerance", rtol)
    )
    variables += [
        _Variable(name, _OUTPUTS + i, "output", "continuous", unit, text)
        for i, (name, unit, text) in enumerate(stepper.channels)
    ]
    variables += _peaks(action, stepper.channels, drive)
    variables += _parameters(action, description, parameters, drive)
    body = _core.write_description(description)
    order = max_order or 0
    token = hashlib.sha256(f"{drive} {hold} {method} {order} {rtol!r} {body}".encode()).hexdigest()
    machine = f"feltmb-unit {token} {drive} {hold} {method} {order} {rtol!r}\n{body}"
    return _write(path, version, action.name, token, variables, {"machine.txt": machine}, force)


@checked
def export_felt(
    law: Law | LawChoice | _core.ContactLaw,
    path: str | Path,
    *,
    name: str = "",
    version: Literal["3.0", "2.0"] = "3.0",
    parameters: str | Iterable[str] = "*",
    force: bool = False,
) -> Path:
    """Write a contact law as a co-simulation FMU for this platform.

    The FMU contains the law and its own binary; it does not need Python. Inputs: ``compression``
    [m], > 0 in contact, and ``rate`` [m/s], its time derivative. Outputs: ``force`` [N], which
    pushes apart, and ``energy`` [J], the stored energy. Memory and parameters are in its state. The
    numbers of the law are parameters (``law.kappa``), the table of a loop is not.

    The force at an input is that of ``law.step`` along the inputs. Behind a step, until the input
    is set again, it is that of ``law.peek`` at ``compression + rate * duration``. Before the first
    step the felt is at rest under its compression.

    Parameters
    ----------
    law
        A law (:func:`feltmb.contact.law`), a contact of a mechanism, or the law of an envelope
        (:meth:`feltmb.felt.FeltEnvelope.law`).
    path
        File of the FMU, ``.fmu``.
    name
        Name of the model; default: the name of the law.
    version
        Version of FMI.
    parameters
        Names of the values that become parameters, such as ``law.kappa``, with ``*`` for any part;
        default: all.
    force
        Replace an existing file.

    Returns
    -------
    Path
        The written file.

    Raises
    ------
    InvalidParameter
        A pattern matches no parameter, or the law is a compiled function.
    FileExists
        The file exists and ``force`` is false.
    """
    path = Path(path)
    check_suffix(path, ".fmu")
    core = core_law(law)
    body = _core.write_law(core)
    # A law may have a number with the name of an input or of the time.
    numbers = [
        _number(_PARAMETERS + i, {**row, "path": f"law.{row['path']}"})
        for i, row in enumerate(_core.law_numbers(core))
    ]
    variables = [
        _Variable("time", _TIME, "independent", "continuous", "s", "time"),
        _Variable(
            "compression", _INPUT, "input", "continuous", "m",
            "compression of the felt, > 0 in contact", 0.0,
        ),
        _Variable(
            "rate", _RATE, "input", "continuous", "m/s",
            "time derivative of the compression, with which it goes on until it is set again", 0.0,
        ),
        _Variable("force", _OUTPUTS, "output", "continuous", "N", "force, pushes apart"),
        _Variable("energy", _OUTPUTS + 1, "output", "continuous", "J", "stored energy"),
        *_wanted(numbers, parameters, core.name),
    ]  # fmt: skip
    name = name or core.name
    token = hashlib.sha256(body.encode()).hexdigest()
    text = f"feltmb-felt {token}\n{body}"
    return _write(path, version, name, token, variables, {"felt.txt": text}, force)


def _write(
    path: Path,
    version: str,
    name: str,
    token: str,
    variables: list[_Variable],
    resources: Mapping[str, str],
    force: bool,
) -> Path:
    """Write a unit: description, binary and resources."""
    binary, folder = _binary(version)
    identifier = re.sub(r"\W", "_", name, flags=re.ASCII) or "mechanism"
    if identifier[0].isdigit():
        identifier = f"m_{identifier}"
    xml = _description(version, name, identifier, token, variables)
    files = {
        "modelDescription.xml": xml.encode(),
        f"binaries/{folder}/{identifier}.so": binary.read_bytes(),
        **{f"resources/{file}": text.encode() for file, text in resources.items()},
    }

    def write(target: Path) -> None:
        with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
            for file, data in files.items():
                # Equal mechanisms give equal bytes.
                info = zipfile.ZipInfo(file, (1980, 1, 1, 0, 0, 0))
                info.compress_type = zipfile.ZIP_DEFLATED
                info.external_attr = (0o755 if file.endswith(".so") else 0o644) << 16
                archive.writestr(info, data)

    return write_file(path, write, force=force)


def _binary(version: str) -> tuple[Path, str]:
    """The binary of FMUs, and the folder in an FMU for this platform."""
    machine = platform.machine()
    if not sys.platform.startswith("linux") or machine not in ("x86_64", "aarch64"):
        raise InvalidParameter(
            f"units are written for Linux on x86-64 or aarch64 only; this is {sys.platform} on "
            f"{machine}"
        )
    if version == "2.0" and machine != "x86_64":
        raise InvalidParameter(f"FMI 2.0 knows no platform of {machine}; write FMI 3.0")
    path = Path(_core.__file__).parent / "_core_fmu.so"
    if not path.is_file():
        raise InvalidParameter(
            f"{path.name} is not installed beside the extension of feltmb; install the package anew"
        )
    return path, f"{machine}-linux" if version == "3.0" else "linux64"


def _peaks(
    action: Action, channels: Iterable[tuple[str, str, str]], drive: Kind
) -> list[_Variable]:
    """Largest force of each contact since the last communication point.

    The pad of the finger is a contact under a motion of the finger only.
    """
    texts = {name: text for name, _, text in channels}
    forces = [(i, f"{name}.force") for i, name in enumerate(action.mechanism.contact_names)]
    return [
        _Variable(
            f"{force}.peak",
            _PEAKS + i,
            "output",
            "continuous",
            "N",
            f"largest since the last communication point, {texts[force]}",
        )
        for i, force in forces
        if force in texts and (drive == "motion" or force != "finger.force")
    ]


def _parameters(
    action: Action,
    description: _core.MechanismDescription,
    wanted: str | Iterable[str],
    drive: Kind,
) -> list[_Variable]:
    """Values of a mechanism that have an influence with an input, and match a pattern."""
    patterns = [wanted] if isinstance(wanted, str) else list(wanted)
    used = [False] * len(patterns)
    idle = [False] * len(patterns)

    def wants(path: str, *, acts: bool = True) -> bool:
        """Whether a pattern matches; notes which one does."""
        matches = [fnmatch.fnmatchcase(path, pattern) for pattern in patterns]
        noted = used if acts else idle
        noted[:] = [a or b for a, b in zip(noted, matches, strict=True)]
        return acts and any(matches)

    found = _starts(action, wants)
    for i, row in enumerate(_core.description_numbers(description)):
        acts = drive == "motion" or not row["path"].startswith("finger.pad.")
        if not wants(row["path"], acts=acts):
            continue
        found.append(_number(_PARAMETERS + i, row))
    for pattern, hit, without_effect in zip(patterns, used, idle, strict=True):
        if not hit and without_effect:
            raise InvalidParameter(
                f"parameters: {pattern!r} matches numbers of the finger's pad only, and these have "
                f"no effect under the input {drive}; hint: --input motion (in Python "
                'drive="motion")'
            )
        if not hit:
            raise InvalidParameter(f"parameters: {pattern!r} matches no number of {action.name!r}")
    return found


def _number(reference: int, row: Mapping[str, Any]) -> _Variable:
    """A real number of a description as a parameter."""
    # A limit that is itself not permitted cannot be stated.
    low = None if row["low_open"] else row["low"]
    high = None if row["high_open"] else row["high"]
    unit, text = row["unit"] or "1", row["meaning"]
    return _Variable(
        row["path"], reference, "parameter", "fixed", unit, text, row["value"], low, high
    )


def _wanted(
    numbers: Sequence[_Variable], wanted: str | Iterable[str], name: str
) -> list[_Variable]:
    """The numbers of a law that match a pattern."""
    patterns = [wanted] if isinstance(wanted, str) else list(wanted)
    for pattern in patterns:
        if pattern != "*" and not any(fnmatch.fnmatchcase(n.name, pattern) for n in numbers):
            raise InvalidParameter(
                f"parameters: {pattern!r} matches no number of the law {name}, expected some of "
                f"{', '.join(n.name for n in numbers) or 'none'}"
            )
    return [n for n in numbers if any(fnmatch.fnmatchcase(n.name, p) for p in patterns)]


def _starts(action: Action, wants: Callable[[str], bool]) -> list[_Variable]:
    """Initial values of the coordinates and their rates, against the rest pose."""
    pairs = list(zip(action.coordinates, action.mechanism.coordinate_units, strict=True))
    rows = [
        *((f"start_offset.{n}", u, f"initial value of {n} minus that at rest") for n, u in pairs),
        *((f"start_rate.{n}", f"{u}/s", f"initial rate of {n}") for n, u in pairs),
    ]
    return [
        _Variable(name, _STARTS + i, "parameter", "fixed", unit, text, 0.0)
        for i, (name, unit, text) in enumerate(rows)
        if wants(name)
    ]


# ---------------------------------------------------------------- model descriptions


def _attributes(values: Mapping[str, object]) -> str:
    return "".join(f" {k}={quoteattr(str(v))}" for k, v in values.items() if v is not None)


def _exponents(unit: str) -> dict[str, int] | None:
    """Exponents of the base units; None if one depends on a parameter."""
    total = [0, 0, 0, 0]
    for place, part in enumerate(unit.split("/")):
        for factor in part.split():
            match = _FACTOR.match(factor)
            if factor == "1":
                continue
            if match is None or match[1] not in _BASE:
                return None
            power = int(match[2] or 1) * (-1 if place else 1)
            total = [t + power * b for t, b in zip(total, _BASE[match[1]], strict=True)]
    return {n: e for n, e in zip(("kg", "m", "s", "rad"), total, strict=True) if e}


def _units(variables: list[_Variable]) -> list[str]:
    lines = ["  <UnitDefinitions>"]
    for unit in sorted({v.unit for v in variables} - {"1"}):
        base = _exponents(unit)
        name = _attributes({"name": unit})
        if base is None:
            lines.append(f"    <Unit{name}/>")
        else:
            lines.append(f"    <Unit{name}><BaseUnit{_attributes(base)}/></Unit>")
    return [*lines, "  </UnitDefinitions>"]


def _real(v: _Variable) -> dict[str, Any]:
    return {
        "unit": None if v.unit == "1" else v.unit,
        "min": None if v.low is None else repr(v.low),
        "max": None if v.high is None else repr(v.high),
        "start": None if v.start is None else repr(v.start),
    }


_EXPERIMENT = '  <DefaultExperiment startTime="0.0" stopTime="0.4" stepSize="0.0001"/>'


def _description(
    version: str, name: str, identifier: str, token: str, variables: list[_Variable]
) -> str:
    """Model description of FMI 2.0 or 3.0, which differ in names and structure."""
    third = version == "3.0"
    state = "FMUState" if third else "FMUstate"
    head = {
        "fmiVersion": version,
        "modelName": name,
        "instantiationToken" if third else "guid": token,
        "generationTool": f"feltmb {_core.__version__}",
        "variableNamingConvention": "flat",
    }
    kind = {
        "modelIdentifier": identifier,
        "canHandleVariableCommunicationStepSize": "true",
        f"canGetAndSet{state}": "true",
        f"canSerialize{state}": "true",
    }
    lines = ['<?xml version="1.0" encoding="UTF-8"?>', f"<fmiModelDescription{_attributes(head)}>"]
    lines += [f"  <CoSimulation{_attributes(kind)}/>", *_units(variables), _EXPERIMENT]
    lines.append("  <ModelVariables>")
    for v in variables:
        own = _attributes(
            {
                "name": v.name,
                "valueReference": v.reference,
                "description": v.text or None,
                "causality": v.causality,
                "variability": v.variability,
                "initial": "calculated" if v.causality == "output" else None,
            }
        )
        real = _attributes(_real(v))
        lines.append(
            f"    <Float64{own}{real}/>"
            if third
            else f"    <ScalarVariable{own}><Real{real}/></ScalarVariable>"
        )
    lines += ["  </ModelVariables>", "  <ModelStructure>"]
    # FMI 3.0 identifies an output by its reference, FMI 2.0 by its index, starting at 1.
    outputs = [(i, v.reference) for i, v in enumerate(variables, 1) if v.causality == "output"]
    for tag in ("Output", "InitialUnknown"):
        if third:
            lines += [f'    <{tag} valueReference="{reference}"/>' for _, reference in outputs]
        else:
            unknowns = [f'      <Unknown index="{place}"/>' for place, _ in outputs]
            lines += [f"    <{tag}s>", *unknowns, f"    </{tag}s>"]
    lines += ["  </ModelStructure>", "</fmiModelDescription>", ""]
    return "\n".join(lines)
