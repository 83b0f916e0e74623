"""Audit of a contact law: valid range, attraction, energy production, and losses.

The curves are audited as data: crossings, negative forces, decreasing ranges. The law with these
curves is audited by its behavior: sign of the force, sign of the power that it dissipates, and the
work of cycles at several amplitudes and frequencies.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from feltmb import _core
from feltmb.contact import Law
from feltmb.contact.layer import ConstantArea
from feltmb.felt.audit_checks import (
    Cycle,
    Finding,
    audit_curves,
    audit_cycles,
    audit_power,
    envelope_curves,
    law_curves,
    material_findings,
    pair_curves,
    shape_findings,
    valid_window,
)
from feltmb.felt.envelopes import FeltEnvelope, envelope, load_envelope
from feltmb.fiber.material import FeltMaterial, load_material
from feltmb.mechanism import Action, LawChoice, core_law, load_action
from feltmb.mechanism.values import expand_path, parse_setting, split_operator
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter
from unmodeled.files import is_file, read_toml
from unmodeled.units.quantity import validated

Array = NDArray[np.float64]

AMPLITUDES = (0.25, 0.5, 0.75, 1.0)
FREQUENCIES = (0.03, 1.0, 30.0, 300.0)


@dataclass(frozen=True)
class Audit:
    """Result of :func:`audit`."""

    name: str
    about: str
    law: str
    """Name of the law, as in a mechanism file."""
    window: tuple[float, float] | None
    """Range of compression with 0 <= F_U <= F_L and increasing curves [m]; None: no such range."""
    closing: float | None
    """Compression at which unloading meets loading [m]."""
    findings: tuple[Finding, ...]
    cycles: tuple[Cycle, ...]
    compression: Array
    """Compression [m]."""
    loading: Array
    """Loading curve [N]."""
    unloading: Array
    """Unloading curve of the whole loop [N]."""
    loading_stiffness: Array
    """dF_L/de [N/m]."""
    unloading_stiffness: Array
    """dF_U/de [N/m]."""

    @property
    def law_is_sound(self) -> bool:
        """Whether the law neither attracts nor produces energy up to the closing compression."""
        end = math.inf if self.closing is None else self.closing
        return not any(
            f.kind in ("energy", "pull") and f.low < end * (1 - 1e-9) for f in self.findings
        )

    @property
    def data_are_sound(self) -> bool:
        """Whether the curves close, are separate and positive, and increase."""
        return not any(
            f.kind in ("crossing", "adhesion", "softening", "open") for f in self.findings
        )

    @property
    def stiffness_range(self) -> dict[str, tuple[float, float]]:
        """Smallest and largest tangent stiffness of both branches [N/m]."""
        return {
            "loading": (float(self.loading_stiffness.min()), float(self.loading_stiffness.max())),
            "unloading": (
                float(self.unloading_stiffness.min()),
                float(self.unloading_stiffness.max()),
            ),
        }

    def to_dict(self) -> dict[str, Any]:
        """Plain data in SI units, without the curves."""
        return {
            "name": self.name,
            "about": self.about,
            "law": self.law,
            "window": None if self.window is None else list(self.window),
            "closing": self.closing,
            "law_is_sound": self.law_is_sound,
            "data_are_sound": self.data_are_sound,
            "stiffness": {k: list(v) for k, v in self.stiffness_range.items()},
            "findings": [asdict(f) for f in self.findings],
            "cycles": [
                {**asdict(c), "loss": c.loss, "first_loss": c.first_loss} for c in self.cycles
            ],
        }


def _audited(
    law: LawChoice | FeltEnvelope | FeltMaterial | Law | _core.ContactLaw, reach: float
) -> tuple[_core.ContactLaw, Any, str, list[Finding]]:
    """Law of the core, its curves, what it is, and what its data show."""
    if isinstance(law, FeltMaterial):
        made = envelope(law, 10e-3, ConstantArea(1e-4))
        core, curves, about, findings = _audited(made, reach)
        specimen = "a flat specimen, 10 mm thick, 100 mm^2"
        about = f"{law.about}; {specimen}" if law.about else specimen
        return core, curves, about, material_findings(law) + findings
    if isinstance(law, FeltEnvelope):
        return law.law(), envelope_curves(law.core), law.about, shape_findings(law.core)
    if isinstance(law, LawChoice):
        return _audited_contact(law, reach)
    core = core_law(law)
    return core, law_curves(core, reach), "", []


def _audited_contact(
    law: LawChoice, reach: float
) -> tuple[_core.ContactLaw, Any, str, list[Finding]]:
    """As :func:`_audited`; the curves are those of the data that the law uses."""
    core = core_law(law)
    loop = core.fields.get("envelope")
    findings = [] if loop is None else shape_findings(loop)
    given = law.law == "micromechanical" or law.memory.envelope is not None
    if loop is not None and given:
        curves = envelope_curves(loop)
    elif law.loading is not None and law.law in ("printed", "guarded", "mean", "felt_memory"):
        curves = pair_curves(law, reach)
    else:
        curves = law_curves(core, reach)
    return core, curves, getattr(law, "label", ""), findings


@checked
def audit(
    law: LawChoice | FeltEnvelope | FeltMaterial | Law | _core.ContactLaw,
    *,
    name: str = "law",
    largest: float | None = None,
    amplitudes: Sequence[float] = AMPLITUDES,
    frequencies: Sequence[float] = FREQUENCIES,
) -> Audit:
    """Audit a contact law.

    Parameters
    ----------
    law
        A contact of a mechanism (``load_action(...).config.contacts["04"]``), an envelope, a felt
        (audited as a flat specimen, 10 mm thick, 100 mm^2), or a law (:func:`feltmb.contact.law`).
    name
        Name in the report.
    largest
        Largest compression for laws without an end of their own [m]; default 1 mm.
    amplitudes
        Amplitudes of the cycles relative to the end of the loop [-].
    frequencies
        Frequencies of the cycles [Hz].

    Returns
    -------
    Audit
        Valid range, faults, losses, stiffness.

    Raises
    ------
    InvalidParameter
        An argument is out of range.
    """
    faults = [
        f"audit: {what} = {x:g}, must be finite and > 0"
        for what, row in (
            ("amplitude", amplitudes),
            ("frequency", frequencies),
            ("largest", [] if largest is None else [largest]),
        )
        for x in row
        if not (math.isfinite(x) and x > 0)
    ]
    if faults:
        raise InvalidParameter("\n".join(faults))
    core, curves, about, findings = _audited(law, largest if largest is not None else 1e-3)
    findings += audit_curves(curves)
    end = curves.closing if curves.closing is not None else curves.reach
    if core.n_states == 0 and not core.has_memory:
        findings += audit_power(core, end, 1.5 * end)
    cycles, more = audit_cycles(core, end, amplitudes, frequencies)
    findings += more
    e = end * np.linspace(0.0, 1.0, 401) ** 1.5
    up, down = curves.loading(e), curves.unloading(e)
    return Audit(
        name=name,
        about=about,
        law=core.name,
        window=valid_window(curves, findings),
        closing=curves.closing,
        findings=tuple(findings),
        cycles=tuple(cycles),
        compression=e,
        loading=up,
        unloading=down,
        loading_stiffness=np.gradient(up, e),
        unloading_stiffness=np.gradient(down, e),
    )


@checked
def audit_targets(
    text: str,
    settings: Sequence[str] = (),
    *,
    everything: bool = False,
    all_hint: str = ", or --all",
    notify: Callable[[str], None] | None = None,
) -> list[tuple[str, LawChoice | FeltEnvelope | FeltMaterial]]:
    """Contacts, felts, envelopes or laws for ``feltmb felt`` ``audit``, ``fit`` and ``fmu``.

    Parameters
    ----------
    text
        ``ACTION:CONTACT`` such as ``steinway45:04``, ``ACTION`` with ``everything``, a felt (name
        or file), a file of an envelope, or a file of the keys of a contact
        (:meth:`LawFit.to_toml`).
    settings
        ``PATH=VALUE`` for mechanisms.
    everything
        Whether all contacts of the mechanism are returned, including switched-off ones.
    all_hint
        Last part of the message about a missing contact.
    notify
        Function that receives what numbers without a unit in ``settings`` became.

    Raises
    ------
    InvalidParameter
        A name does not exist; the message has the known names. Or there are settings for a felt or
        an envelope, or that change none of the laws.
    """
    from feltmb.fiber.material import packaged_materials
    from feltmb.mechanism import packaged_actions
    from feltmb.mechanism.parameters import with_noted_values

    action_name, colon, contact = text.rpartition(":")
    if not colon:
        action_name, contact = text, ""
    if not colon and not everything:
        found = _in_a_file(text, settings)
        if found is not None:
            return [found]
    path = Path(action_name)
    if path.suffix != ".toml" and action_name not in packaged_actions():
        hint = "; hint: feltmb felt contact and identify read a measured loop"
        raise InvalidParameter(
            f"{text!r} is no mechanism ({', '.join(packaged_actions())}), no felt "
            f"({', '.join(packaged_materials())}) and no file ending in .toml; expected "
            f"ACTION:CONTACT, a felt, an envelope or a law{hint if is_file(path) else ''}"
        )
    action = with_noted_values(load_action(action_name), settings, notify)
    contacts = action.config.contacts
    if everything and not colon:
        _refuse_idle(action, settings, list(contacts))
        return [(f"{action.name}:{k}", c) for k, c in contacts.items()]
    if contact not in contacts:
        what = f"contact {contact!r} of {action_name} does not exist"
        raise InvalidParameter(
            f"{what if contact else f'{text!r} names no contact'}: expected one of "
            f"{', '.join(contacts)}, written as {action_name}:{next(iter(contacts), '01')}"
            f"{all_hint}"
        )
    _refuse_idle(action, settings, [contact])
    return [(f"{action.name}:{contact}", contacts[contact])]


def _refuse_idle(action: Action, settings: Sequence[str], contacts: Sequence[str]) -> None:
    """Refuse settings that reach no key of a law of these contacts."""
    known = ({"contacts"}, contacts, LawChoice.model_fields)
    idle = [
        path
        for path, _ in map(parse_setting, settings)
        if not any(
            all(part in names for part, names in zip(parts, known, strict=False))
            for parts in expand_path(action.raw, split_operator(path)[0])
        )
    ]
    if idle:
        raise InvalidParameter(
            f"--set {', '.join(idle)}: has no effect on the law of contact "
            f"{', '.join(contacts)}; expected a key of it, such as contacts.{contacts[0]}.law"
        )


def _in_a_file(
    text: str, settings: Sequence[str]
) -> tuple[str, LawChoice | FeltEnvelope | FeltMaterial] | None:
    """A felt by its name or file, or a file of an envelope or a law; None: none of them."""
    from feltmb.fiber.material import packaged_materials

    path = Path(text)
    raw = read_toml(path) if path.suffix == ".toml" else {}
    felt = text in packaged_materials() or "fiber" in raw
    law = "law" in raw
    if not felt and not law and "memory" not in raw:
        return None
    if settings:
        kind = "a felt" if felt else "a law" if law else "an envelope"
        raise InvalidParameter(
            f"{', '.join(settings)}: {text} is {kind}, and "
            "settings change a mechanism; expected ACTION:CONTACT, or a changed file of it"
        )
    if law:
        return path.stem, validated(LawChoice, raw, str(path))
    return (text, load_material(text)) if felt else (path.stem, load_envelope(path))
