"""Page for the customer of a workshop: what was found, what the hand feels, what was done.

The page fits on one sheet (A4), as PDF of matplotlib or as HTML. Lengths are in mm, weights in g.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feltmb.action.touch import StaticTouch, distances, static_touch
from feltmb.adapters import Entry, Library, action_with_effects, load_library
from feltmb.adapters.findings import bodies_at, points_at
from feltmb.mechanism import Action, load_action
from unmodeled.arguments import checked
from unmodeled.errors import Error, InvalidParameter
from unmodeled.files import (
    check_suffix,
    is_folder,
    read_input,
    read_json,
    write_file,
    write_text,
)
from unmodeled.report.words import turn_back, turned
from unmodeled.units import readable_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["CustomerPage", "customer_page"]

GRAM = 9.80665e-3  # N, weight of one gram
PAPER = (8.27, 11.69)  # inches, A4
LARGEST_PHOTO = 50_000_000  # bytes
FORMAT = "unmodeled diagnosis"
#: Change of a weight that is reported [g].
FELT = 0.5
#: Kinds of changes that are those of the instrument.
PARTS = ("force", "kinematic", "state", "parameter", "drift")


@dataclass(frozen=True, eq=False)
class CustomerPage:
    """One page for a customer.

    Attributes
    ----------
    before, after : Action
        The instrument as it was measured, and without the causes.
    bodies : tuple of str
        Bodies of the guilty parts.
    points : tuple
        Places of the guilty felts [m].
    found : str
        What was found.
    work : tuple of str
        Work, one sentence each.
    done : bool
        Whether it was done, or should be done.
    """

    title: str
    workshop: str
    before: Action
    after: Action
    bodies: tuple[str, ...]
    points: tuple[tuple[float, float], ...]
    found: str
    work: tuple[str, ...]
    done: bool
    photo: Path | None = None

    @cached_property
    def touches(self) -> tuple[StaticTouch | None, StaticTouch]:
        """Slow press and release before and after; None: it cannot be played slowly."""
        after = static_touch(self.after)
        if self.before is self.after:
            return after, after
        try:
            return static_touch(self.before), after
        except InvalidParameter:
            raise
        except Error:  # so far from regulated that it has no weights
            return None, after

    @cached_property
    def sentences(self) -> tuple[str, str, str]:
        """What was found, what the hand feels, and what is left after the let-off."""
        same = self.before is self.after
        old, new = self.touches
        left = _aftertouch(self.after, new)
        told = math.nan if old is None else _aftertouch(self.before, old)
        return self.found, self._hand(old, new, same), self._left(told, left, same)

    @property
    def times(self) -> tuple[str, str]:
        """Words for the action with the causes, and without them."""
        return ("before", "after") if self.done else ("now", "after the work")

    @property
    def _as_well(self) -> str:
        """What is said of what the work does not change."""
        return "as before" if self.done else "now and after the work"

    def _hand(self, before: StaticTouch | None, after: StaticTouch, same: bool) -> str:
        """What the hand feels, in grams."""

        def weights(touch: StaticTouch) -> tuple[str, str]:
            return f"{touch.down_weight / GRAM:.0f} g", f"{touch.up_weight / GRAM:.0f} g"

        told = after if self.done or same or before is None else before
        now = "With the damper lifted, the key goes down with {} and lifts {}".format(
            *weights(told)
        )
        if same:
            return f"{now}."
        if before is None:
            if self.done:
                return f"Before the work, the key could not be played slowly. {now}."
            return f"The key cannot be played slowly. After the work: {now[:1].lower()}{now[1:]}."
        changes = (
            abs(getattr(before, w) - getattr(after, w)) for w in ("down_weight", "up_weight")
        )
        if max(changes) < FELT * GRAM:
            return f"{now}, {self._as_well}."
        if self.done:
            return "{}; before, it was {} and {}.".format(now, *weights(before))
        return "{}; after the work, it will be {} and {}.".format(now, *weights(after))

    def _left(self, before: float, after: float, same: bool) -> str:
        """Travel of the key after the let-off [mm]; 0: there is no let-off; NaN: not measured."""
        now_then = (after, before) if self.done or same else (before, after)
        first, other = (round(max(mm, 0.0), 1) for mm in now_then)
        when, has, did = (
            ("before", "had", "did") if self.done else ("after the work", "will have", "will")
        )
        then = f"the hammer {did} not let off"
        if other > 0.0:
            then = f"the key {has} {other:.1f} mm of travel left after the let-off"
        if math.isnan(first):
            if same or math.isnan(other):
                return "The travel of the key after the let-off could not be measured."
            return f"{when[:1].upper()}{when[1:]}, {then}."
        now = "The hammer does not let off before the key is at its end"
        if first > 0.0:
            now = f"After the let-off, the key has {first:.1f} mm of travel left"
        if same or math.isnan(other):
            return f"{now}."
        if first > 0.0 and other > 0.0:
            then = f"it {has} {other:.1f} mm"
        if first == other:
            return f"{now}, {self._as_well}."
        return f"{now}; {when}, {then}."

    @property
    def head(self) -> str:
        """Head of the work."""
        return "What was done" if self.done else "What should be done"

    def figure(self) -> Figure:
        """The page as a figure of the size of a sheet."""
        from unmodeled.style import GRAY, INK, new_figure, plain_text

        figure = new_figure(*PAPER)
        figure.set_layout_engine("none")
        top = 0.955
        if self.workshop:
            workshop = plain_text(self.workshop)
            figure.text(0.08, top, workshop, size=10, color=GRAY, va="top")
            top -= 0.028
        title = plain_text(self.title)
        figure.text(0.08, top, title, size=17, weight="bold", color=INK, va="top")
        lines = _folded(self.sentences, 84)
        figure.text(0.08, top - 0.045, lines, size=11, color=INK, va="top", linespacing=1.45)
        bottom = top - 0.06 - 0.0205 * (lines.count("\n") + 1)
        work = _folded([f"•  {text}" for text in self.work], 84)
        foot = 0.06 + (0.045 + 0.0205 * (work.count("\n") + 1) if self.work else 0.0)
        middle = foot + 0.45 * (bottom - foot)
        width = 0.5 if self.photo is not None else 0.84
        self.draw(figure.add_axes((0.08, middle + 0.01, width, bottom - middle - 0.02)))
        if self.photo is not None:
            ax = figure.add_axes((0.6, middle + 0.02, 0.32, bottom - middle - 0.04))
            ax.imshow(_image(self.photo))
            ax.set_axis_off()
        self.curve(figure.add_axes((0.14, foot + 0.05, 0.78, middle - foot - 0.08)))
        if self.work:
            figure.text(0.08, foot - 0.02, self.head, size=12, weight="bold", va="top")
            figure.text(0.08, foot - 0.045, work, size=11, color=INK, va="top", linespacing=1.45)
        return figure

    def draw(self, ax: Axes) -> None:
        """Draw the mechanism with the guilty parts colored."""
        from feltmb.graphics.plot.portrait import sketch
        from unmodeled.style import RED

        # A felt between two parts: the ring shows it, the parts are pale.
        sketch(ax, self.after, dict.fromkeys(self.bodies, 0.25 if self.points else 0.75))
        for x, y in self.points:
            ax.plot([x], [y], "o", ms=26, mfc="none", mec=RED, mew=2.2, zorder=9)

    def curve(self, ax: Axes) -> None:
        """Draw the force at the key against its travel, before and after."""
        from unmodeled.style import BLUE, RED, style_axes

        before, after = self.touches
        same = self.before is self.after
        shown = ((before, RED, self.times[0]), (after, BLUE, self.times[1]))
        most = 0.0
        for touch, color, name in shown[1:] if same else shown:
            if touch is None:
                continue
            label = "as it is" if same else name
            # The told weights are means of these curves: the damper does not take part.
            down, up = touch.lifted_press, touch.lifted_release
            for path, mean, what, style in ((down, touch.down_weight, "goes down with", "-"),
                                            (up, touch.up_weight, "lifts", "--")):  # fmt: skip
                weight = f"{label}: {what} {mean / GRAM:.0f} g"
                ax.plot(1e3 * path.travel, path.force / GRAM, color=color, lw=1.8, ls=style,
                        label=weight)  # fmt: skip
                low, high = (1e3 * w for w in touch.window)
                ax.hlines(mean / GRAM, low, high, color=color, lw=0.8, ls=":")
            most = max(most, 2.2 * touch.down_weight / GRAM)
        ax.set_ylim(0.0, most)
        ax.set_xlim(left=0.0)
        title = "What the hand feels, with the damper lifted; dotted: mean"
        style_axes(ax, "travel of the key [mm]", "weight at the key [g]", title)
        ax.legend(frameon=False, loc="upper left", ncols=2)

    def html(self) -> str:
        """The page as HTML that loads nothing and prints on one sheet."""
        import base64

        from markupsafe import Markup

        from unmodeled.report import render_page
        from unmodeled.report.figures import svg
        from unmodeled.style import new_figure

        pictures = []
        for name, draw, size in (
            ("mechanism with the guilty part", self.draw, (6.6, 4.4)),
            ("weight at the key against travel", self.curve, (6.6, 3.2)),
        ):
            figure = new_figure(*size)
            draw(figure.subplots())
            pictures.append(Markup(svg(figure, name)))
        photo = ""
        if self.photo is not None:
            kind = "jpeg" if self.photo.suffix.lower() in (".jpg", ".jpeg") else "png"
            data = base64.b64encode(read_input(self.photo, most=LARGEST_PHOTO)).decode()
            photo = f"data:image/{kind};base64,{data}"
        return render_page(
            "customer.html",
            package="feltmb.action",
            page=self,
            drawing=pictures[0],
            curve=pictures[1],
            photo=photo,
        )

    @checked
    def write(self, path: str | Path, *, force: bool = False) -> Path:
        """Write the page as .pdf or .html.

        Parameters
        ----------
        path
            File to be written.
        force
            False: an existing file is not overwritten.
        """
        path = Path(path)
        check_suffix(path, ".pdf", ".html")
        if path.suffix.lower() != ".pdf":
            return write_text(path, self.html(), force=force)
        figure, metadata = self.figure(), {"CreationDate": None}

        def save(file: Path) -> None:
            figure.savefig(file, format="pdf", metadata=metadata)

        return write_file(path, save, force=force)


def _folded(texts: Sequence[str], width: int) -> str:
    from unmodeled.style import plain_text
    from unmodeled.tables import folded_text

    return plain_text("\n".join(folded_text(text, width) for text in texts))


def _image(path: Path) -> Any:
    import matplotlib.image

    try:
        return matplotlib.image.imread(path)
    except (OSError, ValueError, SyntaxError) as error:
        raise InvalidParameter(
            f"{path}: cannot be read as a picture ({error}), expected PNG or JPEG"
        ) from None


# ---------------------------------------------------------------- from the result of a diagnosis


@dataclass(frozen=True)
class _Cause:
    """A change of the list, with what the library says about it."""

    entry: Entry | None
    component: str
    thing: str
    mechanism: str
    remedy: str
    unit: str
    size_si: float
    turns: tuple[str, str, str] | None
    """Turns of a screw as words, their direction, and the way back."""
    further: str
    """Size in another unit of its owner, such as grams; "": there is none."""
    shape: float | None
    parameter: bool

    @cached_property
    def plain(self) -> str:
        """What is wrong, with the label of a contact instead of its number."""
        number, mark, label = self.component.partition(", ")
        part = self.entry.part if self.entry is not None else ""
        text = self.mechanism or f"{part or f'The {self.component}'} is not as its table says"
        if mark and number.startswith("contact"):
            text = text.replace(number, label)
        return text[:1].upper() + text[1:]

    @cached_property
    def work(self) -> str:
        """What to do about it."""
        if self.turns is not None:
            back = turn_back(f"the {self.component}", self.turns)
            return f"{back[:1].upper()}{back[1:]}."
        return self.remedy or f"Check {self.thing}."

    @cached_property
    def size(self) -> str:
        """Size for people: mm and turns, g, or a share of the number that it changes."""
        factor, unit = readable_unit(self.size_si, self.unit)
        if self.unit == "m":
            factor, unit = 1e3, "mm"
        text = f"{factor * self.size_si:.3g} {unit}"
        if self.unit == "1":
            text = f"{100.0 * self.size_si:+.3g} %"
        if self.turns is not None:
            text += f", {self.turns[0]} {self.turns[1]}"
        text += f", {self.further}" * bool(self.further)
        return text.replace(" ", "\N{NO-BREAK SPACE}")


def _causes(data: Mapping[str, Any], library: Mapping[str, Entry]) -> list[list[_Cause]]:
    """The list of changes; several in one place: one of them."""
    return [
        [_cause(row, library) for row in (change, *change.get("equivalents", ()))]
        for change in data["changes"]
    ]


def _cause(row: Mapping[str, Any], library: Mapping[str, Entry]) -> _Cause:
    entry, turns, shape, further = library.get(row["name"]), None, row.get("shape"), ""
    off = f"{row['title']} is off" if row["tier"] == "fitted" else ""
    if (unit := row.get("user_unit")) is not None and unit["unit"] == "turn":
        size, low, high = (float(row.get(end, row["size"])) for end in ("size", "low", "high"))
        turns = turned(size, low, high, unit["per_unit"], unit["words"])
    elif unit is not None:
        other = float(unit["per_unit"]) * float(row["size"])
        factor, name = readable_unit(other, unit["unit"])
        further = f"{factor * other:+.3g} {name}"
    component = str(row["component"] or (entry.component if entry else row["name"]))
    thing = str(row["title"]) if row["tier"] == "fitted" else f"the {component}"
    return _Cause(
        entry,
        component,
        f"{thing[:1].lower()}{thing[1:]}",
        str(off or row["mechanism"] or (entry.mechanism if entry else "")),
        str(row["remedy"] or (entry.remedy if entry else "")),
        str(row["unit"]),
        float(row["size"]),
        turns,
        further,
        float(shape) if isinstance(shape, (int, float)) else None,
        row["tier"] == "fitted",
    )


def _read(path: Path) -> Mapping[str, Any]:
    file = path / "report.json" if is_folder(path) else path
    data = read_json(file)
    needed = ("changes", "parameters", "verdict")
    if (
        not isinstance(data, dict)
        or data.get("format") != FORMAT
        or not all(k in data for k in needed)
    ):
        raise InvalidParameter(
            f"{file}: is no result of a diagnosis of this version; expected the report.json of "
            "feltmb gap diagnose --out DIRECTORY"
        )
    return data


def _guilty(action: Action, causes: Sequence[_Cause]) -> tuple[tuple[str, ...], tuple[Any, ...]]:
    """Bodies and points to which the causes belong."""
    bodies: dict[str, None] = {}
    points: dict[Any, None] = {}
    for cause in causes:
        paths = [x.path for x in cause.entry.changes] if cause.entry else []
        bodies |= dict.fromkeys(bodies_at(action.config, cause.component, paths))
        points |= dict.fromkeys(points_at(action, cause.component, paths))
    return tuple(bodies), tuple(points)


def _guilty_groups(
    data: Mapping[str, Any], base: Action, entries: Mapping[str, Entry]
) -> list[list[_Cause]]:
    """The groups of causes that are parts: a late camera is no fault of the instrument."""
    groups = _causes(data, entries)
    if strange := [c.component for g in groups for c in g if c.entry is None]:
        raise InvalidParameter(
            f"mechanism {base.name!r} has no {', '.join(strange)}: the result is that of another "
            "mechanism; give the one that was diagnosed"
        )
    return [g for g in groups if any(_is_part(c) for c in g)]


def _is_part(cause: _Cause) -> bool:
    return cause.entry is not None and cause.entry.kind in PARTS


def _actions(
    data: Mapping[str, Any], base: Action, entries: Mapping[str, Entry], groups: list[list[_Cause]]
) -> tuple[Action, Action]:
    """The mechanism with and without the causes, both with the fitted parameters."""
    causes = [c for group in groups for c in group]
    listed = {c.entry.name for c in causes if c.entry}
    fitted = [
        (entries[p["name"]], float(p["value"]) - float(p["tabulated"]), None)
        for p in data["parameters"]
        if p["name"] in entries.keys() - listed and not any(c.parameter for c in causes)
    ]
    healthy = action_with_effects(base, fitted)
    first = [next(c for c in g if _is_part(c)) for g in groups]
    changes = [(c.entry, c.size_si, c.shape) for c in first if c.entry]
    return action_with_effects(healthy, changes), healthy


@checked
def customer_page(
    result: str | Path,
    action: Action | str,
    *,
    after: Action | str | None = None,
    title: str = "Your piano action",
    workshop: str = "",
    done: Sequence[str] = (),
    photo: str | Path | None = None,
) -> CustomerPage:
    """Make the page for a customer from the result of a diagnosis.

    Parameters
    ----------
    result
        report.json of a diagnosis, or its folder.
    action
        Mechanism that was diagnosed, with its tabulated values, or its name.
    after
        Mechanism after the work; default: the diagnosed one without the causes.
    title
        Head line, such as the instrument and the note.
    workshop
        Name of the workshop; default: none.
    done
        Sentences about the work; default: the remedies, as work to be done.
    photo
        Picture, PNG or JPEG.

    Raises
    ------
    InvalidParameter
        A file is no result of a diagnosis or no picture, or the mechanism has no touch.
    """
    data = _read(Path(result))
    base = load_action(action) if isinstance(action, str) else action
    if photo is not None:
        photo = Path(photo)
        _image(photo)
    library = load_library(base)
    entries = {e.name: e for e in (*library.tolerances, *library.effects)}
    groups = _guilty_groups(data, base, entries)
    causes = [c for group in groups for c in group]
    faulty, healthy = _actions(data, base, entries, groups)
    if after is not None:
        healthy = load_action(after) if isinstance(after, str) else after
    bodies, points = _guilty(base, causes)
    remedies = tuple(dict.fromkeys(c.work for c in causes))
    if not causes:
        remedies = (_UNCLEAR if data["verdict"] == "UNKNOWN" else _NOTHING,)
    if not all(text.strip() for text in done):
        raise InvalidParameter(
            "done: got an empty sentence, expected the work that was done, such as 'Bushing "
            "eased.'; without done, the page tells what should be done"
        )
    return CustomerPage(
        title=title,
        workshop=workshop,
        before=faulty,
        after=healthy,
        bodies=bodies,
        points=points,
        found=_found(groups, data["verdict"]),
        work=tuple(done) or remedies,
        done=bool(done),
        photo=photo,
    )


#: Work without a cause.
_NOTHING = "Nothing needs to be done."
_UNCLEAR = "Look at the whole action by hand, regulate it, and measure again."


def finding(data: Mapping[str, Any], library: Library | None) -> str:
    """What a diagnosis found, in one sentence.

    Parameters
    ----------
    data
        Report as plain data.
    library
        Library of the mechanism, for its words.
    """
    entries = (*library.tolerances, *library.effects) if library else ()
    causes = _causes(data, {e.name: e for e in entries})
    return _found(causes, data["verdict"])


def _found(groups: Sequence[Sequence[_Cause]], verdict: str) -> str:
    if not groups:
        if verdict == "UNKNOWN":
            return (
                "The motion differs from that of a sound action, and no single cause explains it."
            )
        return "The action moves as a sound action does."
    sentences = []
    for group in groups:
        texts = [f"{c.plain.rstrip('.')} ({c.size})" for c in group]
        if len(texts) > 1:
            inner = [t[:1].lower() + t[1:] for t in texts]
            texts = [f"One of these was found: {'; or '.join(inner)}"]
        sentences.append(f"{texts[0]}.")
    return " ".join(sentences)


def _aftertouch(action: Action, static: StaticTouch) -> float:
    """Travel of the key after the let-off [mm]; 0: there is no let-off; NaN: not measured."""
    from feltmb.run.quasistatic import simulated_press

    if not static.has_let_off:
        return 0.0
    press = simulated_press(action, travel=static.end + 1.2e-3)
    return 1e3 * distances(action, static, press).aftertouch
