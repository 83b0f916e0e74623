"""A mechanism read from data: the central object of the package."""

from __future__ import annotations

import copy
import hashlib
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from feltmb import _core
from feltmb.contact.laws import Law
from feltmb.contact.tables import CORE_LAWS, LAWS
from feltmb.display import html_table, picture
from feltmb.mechanism.checking import validate
from feltmb.mechanism.numbers import BareChange, Value, bare_changes, number_at
from feltmb.mechanism.reading import load_raw, resolve
from feltmb.mechanism.to_core import describe
from feltmb.mechanism.values import (
    apply_numbers,
    apply_values,
    check_values,
    expand_path,
    plain_data,
)
from feltmb.mechanism.workshop import plain_values
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter, shown
from unmodeled.lazy import lazy_import
from unmodeled.units.quantity import (
    is_quantity,
)

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt
    from matplotlib.figure import Figure

#: Tables of laws that are newer than the first results; files without them keep their hash.
_LATER_LAWS = {law.table for name, law in CORE_LAWS.items() if name in LAWS} - {
    *("", "memory", "hunt_crossley", "stulov")
}

#: Notes that a mechanism shows of itself.
_SHOWN = 3


@checked
def load_action(name_or_path: str | Path) -> Action:
    """Read a mechanism: the name of a packaged data set, or the path of a TOML file.

    Raises
    ------
    InvalidParameter
        The file has faults; all of them are in the message.

    Examples
    --------
    A packaged mechanism by its name:

    >>> from feltmb import load_action
    >>> load_action("steinway45").name
    'steinway45'
    """
    path = resolve(name_or_path)
    return Action(load_raw(path, resolve), origin=path.name)


@checked
class Action:
    """A mechanism read from data. It is immutable and safe to share between threads.

    Parameters
    ----------
    raw
        The tables of a mechanism file.
    origin
        Name in messages, usually the name of the file.
    """

    def __init__(self, raw: Mapping[str, Any], origin: str = "mechanism"):
        try:
            self._raw = plain_data(raw)
        except InvalidParameter as error:
            raise InvalidParameter(f"{origin}: {error}") from None
        self.origin = origin
        #: Laws of :meth:`with_laws` by contact.
        self.laws: dict[str, Law] = {}
        self._bare: dict[str, BareChange] = {}
        self.config, self.mechanism = validate(self._raw, origin)

    def __repr__(self) -> str:
        short = f"Action({self.name!r}, {len(self.coordinates)} coordinates, hash {self.hash[:12]})"
        more = len(self.notes) - _SHOWN
        rest = [f"and {more} more such numbers (notes)"] if more > 0 else []
        return "\n  ".join([short, *self.notes[:_SHOWN], *rest])

    def _repr_html_(self) -> str:
        rows = [
            (
                number,
                c.label,
                " - ".join(c.surfaces),
                c.law if isinstance(c.law, str) else c.law.name,
            )
            for number, c in self.config.contacts.items()
        ]
        return html_table(repr(self), ("contact", "where", "surfaces", "law"), rows)

    def plot(self) -> Figure:
        """Plot the mechanism at rest.

        Returns
        -------
        Figure
            Figure of matplotlib.
        """
        return picture("mechanism", self)

    def diagnose(
        self,
        records: Any,
        *,
        effects: Sequence[Any] | None = None,
        exclude: Sequence[str] | str = (),
        hold_out: Sequence[str] | str | None = None,
        options: Any = None,
        progress: Callable[..., None] | None = None,
    ) -> Any:
        """Find what the mechanism lacks: :meth:`unmodeled.fit.Model.diagnose` of its model.

        Parameters
        ----------
        records
            Measured runs, for example of :func:`unmodeled.read`. Their inputs are ``force`` [N] or
            ``displacement`` [m], their outputs ``hammer_tip.x`` [m] and others.
        effects, exclude, hold_out, options, progress
            As for a model; the default effects are those of the library of the mechanism.

        Returns
        -------
        unmodeled.Report
        """
        chosen = {"effects": effects, "exclude": exclude, "hold_out": hold_out}
        return self._as_model(records).diagnose(
            records, options=options, progress=progress, **chosen
        )

    def fit(
        self, records: Any, *, options: Any = None, progress: Callable[..., None] | None = None
    ) -> Any:
        """Fit its tolerances to records: :meth:`unmodeled.fit.Model.fit` of its model.

        Parameters
        ----------
        records
            Measured runs, as for :meth:`diagnose`.
        options, progress
            As for :func:`unmodeled.fit_model`.

        Returns
        -------
        unmodeled.Report
        """
        return self._as_model(records).fit(records, options=options, progress=progress)

    def _as_model(self, records: Any) -> Any:
        return lazy_import("feltmb.adapters.model:model_of")(self, records)

    def __reduce__(self) -> tuple[Any, ...]:
        self._refuse_laws("pickled")
        return (Action, (self._raw, self.origin))

    def _refuse_laws(self, what: str) -> None:
        if self.laws:
            raise InvalidParameter(
                f"{self.name}: contacts {', '.join(self.laws)} follow laws of with_laws, which "
                f"cannot be {what}; expected a mechanism whose laws are in its file"
            )

    @property
    def name(self) -> str:
        """Name of the data set."""
        return self.config.name

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the mechanical coordinates in the order of q."""
        return tuple(self.mechanism.coordinates)

    @property
    def doubts(self) -> tuple[str, ...]:
        """The :attr:`notes` about numbers that may have been meant in the unit of the file.

        They differ more than tenfold from what they were; each run has them as warnings.
        """
        return tuple(change.text for change in self._bare.values() if change.doubted)

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences about changed numbers without a unit where the file has another than SI."""
        return tuple(change.text for change in self._bare.values())

    @property
    def raw(self) -> dict[str, Any]:
        """Copy of the tables of the file, with units and sources."""
        return copy.deepcopy(self._raw)

    @cached_property
    def hash(self) -> str:
        """SHA-256 of all parameters in SI units, without labels, notes and sources."""
        tables = self.config.model_dump(mode="json", exclude={"name", "about", "source"})
        reading = tables.pop("reading")  # only entries that change the results of a run
        roles = ("strike_contact", "let_off_contact", "check_contacts", "key_point")
        tables["summary"] = {name: reading[name] for name in roles}
        if reading["rows"]:
            tables["rows"] = reading["rows"]
        del tables["screws"]  # names only
        tables["bushings"] = {
            key: b for key, b in tables["bushings"].items() if self.config.bushings[key].friction
        }
        for table in ("motor", "dashpots", "leads", "bushings"):
            if not tables[table]:
                del tables[table]  # as before this entry existed: results keep their hash
        if tables["string"] and tables["string"]["count"] == 1:
            del tables["string"]["count"]  # for the same reason
        if tables["string"] and not tables["string"]["other_surfaces"]:
            del tables["string"]["other_surfaces"]
        for surface in tables["surfaces"].values():
            if surface["end"] is None:
                del surface["end"]  # as before surfaces could have ends
        for key, contact in self.config.contacts.items():
            for table in _LATER_LAWS:
                if getattr(contact, table) == type(contact).model_fields[table].default:
                    del tables["contacts"][key][table]
        for key, own in self.laws.items():
            tables["contacts"][key]["law"] = f"{own.name} {own.core.fields}"
        text = json.dumps(_without_texts(tables), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def value(self, path: str) -> Value:
        """Number at a dotted path, in SI units.

        Parameters
        ----------
        path
            A path as for :meth:`with_values`, which names one number: ``"bodies.key.mass"``.

        Returns
        -------
        Value
            ``value`` and ``unit``: ``number, unit = action.value("bodies.key.mass")``. The value of
            a point or a direction is a pair.

        Raises
        ------
        InvalidParameter
            The path does not exist, is no number, or names several.
        """
        found = expand_path(self._raw, path)
        if len(found) != 1:
            names = ", ".join(".".join(parts) for parts in found[:20]) or "nothing"
            raise InvalidParameter(f"value: {path!r} names {names}; expected one number")
        return number_at(self.config, found[0])

    def with_values(self, values: Mapping[str, Any]) -> Action:
        """Copy with other values by dotted path.

        Parameters
        ----------
        values
            ``{"string.modes": 80}``. A number without a unit is in SI units, whatever the unit in
            the file, and is told in :attr:`notes` if this is another one; a text may have a unit,
            ``"10.5 mm"``. ``*`` means any key
            (``"contacts.*.law"``), the name of a body means ``bodies.NAME`` (``"shank.rigid"``),
            and ``.x .y`` or ``.0 .1`` is a component of a point.
            ``{"surfaces.Gp10.point.y +=": "0.5 mm"}`` changes a number by an amount, also with
            ``-=``; ``*=`` changes it by a factor.

        Raises
        ------
        InvalidParameter
            A path does not exist, or a value is out of range.
        """
        if isinstance(values, Mapping):
            check_values(values, "with_values")
            values = plain_values(self.config, self._raw, values)
        changed = self._with_numbers(values) or Action(
            apply_values(self._raw, values, "with_values"), self.origin
        )
        changed._bare = bare_changes(self._raw, self.config, changed.config, values, self._bare)
        return changed.with_laws(self.laws) if self.laws else changed

    def with_laws(self, laws: Mapping[str, Law]) -> Action:
        """Copy with contact laws that a file cannot contain, such as a compiled function.

        Parameters
        ----------
        laws
            Law by the key of the contact: ``{"06": law("callback", function=f)}``. The tables of
            the contact are kept but have no effect. The copy cannot be pickled, and a file written
            from it names these contacts in a comment.

        Raises
        ------
        InvalidParameter
            A contact does not exist, or a value is not a law.
        """
        given = {**self.laws, **laws}
        for key, own in given.items():
            if key not in self.config.contacts:
                known = ", ".join(self.config.contacts)
                raise InvalidParameter(f"with_laws: contact {key!r} is missing; known are {known}")
            if not isinstance(own, Law):
                raise InvalidParameter(f"with_laws: {key}: got {shown(own)}, expected a law")
        changed = Action.__new__(Action)
        changed._raw, changed.origin, changed.config = self._raw, self.origin, self.config
        changed.laws, changed._bare = given, self._bare
        changed.mechanism = changed._assembled()
        return changed

    def _assembled(self) -> Any:
        """Mechanism of the core, including laws that a file cannot contain."""
        description = describe(self.config)
        contacts = description.contacts
        for contact in contacts:
            own = self.laws.get(f"{contact.number:02d}")
            if own is not None:
                contact.law = own.core
        description.contacts = contacts
        return _core.assemble(description)

    def _with_numbers(self, values: Mapping[str, Any]) -> Action | None:
        """Copy that shares all unchanged parts; None if a complete check is needed."""
        try:
            raw, touched = apply_numbers(self._raw, values)
            config = self.config
            layers = [c for c in config.contacts.values() if c.micromechanical is not None]
            for table, key in touched:
                old = getattr(config, table)[key]
                new = type(old).model_validate(raw[table][key])
                if old in layers or (layers and table == "surfaces" and old.radius != new.radius):
                    return None  # a layer may take its radii from the surfaces
                config = config.model_copy(update={table: {**getattr(config, table), key: new}})
            mechanism = _core.assemble(describe(config, dict(self.described)))
        except (ValidationError, InvalidParameter, ValueError, TypeError, KeyError):
            return None  # the complete check reports the fault
        changed = Action.__new__(Action)
        changed._raw, changed.origin, changed.laws, changed._bare = raw, self.origin, {}, {}
        changed.config, changed.mechanism = config, mechanism
        return changed

    @cached_property
    def described(self) -> dict[int, tuple[Any, Any]]:
        """Parts of the description, by the part of the file from which they were made."""
        known: dict[int, tuple[Any, Any]] = {}
        describe(self.config, known)
        return known

    def to_toml(self) -> str:
        """Text of a file that defines this mechanism."""
        import tomlkit

        text = tomlkit.dumps(self._raw)
        lines = [
            f"# contact {key} followed {own.name!r} instead\n" for key, own in self.laws.items()
        ]
        return "".join(lines) + text

    @cached_property
    def equilibrium(self) -> dict[str, Any]:
        """Rest under gravity: coordinates ``q``, states, iterations, residual."""
        return dict(_core.find_equilibrium(self.mechanism))

    @property
    def rest_pose(self) -> npt.NDArray[np.float64]:
        """Coordinates at rest under gravity [rad, m], computed by an equilibrium solve."""
        pose: npt.NDArray[np.float64] = self.equilibrium["q"].copy()
        return pose

    @property
    def rest_iterations(self) -> int:
        """Number of iterations of the equilibrium solve."""
        return int(self.equilibrium["iterations"])

    def quantities(self) -> Iterator[tuple[str, Any, str, str]]:
        """Every number of the file: dotted path, value, unit, and source or status."""
        yield from _walk(self._raw, "")


def _without_texts(node: Any) -> Any:
    if isinstance(node, Mapping):
        return {
            key: _without_texts(value)
            for key, value in node.items()
            if key not in ("label", "note") or not isinstance(value, str)
        }
    return node


def _walk(node: Any, path: str) -> Iterator[tuple[str, Any, str, str]]:
    if is_quantity(node):
        source = str(node.get("source", ""))
        if node.get("status"):
            source = f"{source} ({node['status']})" if source else str(node["status"])
        yield path, node["value"], str(node.get("unit", "1")), source
    elif isinstance(node, Mapping):
        if isinstance(node.get("unit"), list):
            for key, unit in zip("abc", node["unit"], strict=False):
                if key in node:
                    yield f"{path}.{key}", node[key], str(unit), str(node.get("source", ""))
            return
        for key, value in node.items():
            yield from _walk(value, f"{path}.{key}" if path else str(key))
    elif _is_number(node) or (
        isinstance(node, list) and len(node) == 2 and all(map(_is_number, node))
    ):
        yield path, node, "", ""


def _is_number(node: Any) -> bool:
    return isinstance(node, (int, float)) and not isinstance(node, bool) and math.isfinite(node)
