"""The live page as one file: the core simulates in the browser, without a server."""

from __future__ import annotations

import base64
import html
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from feltmb import _core
from feltmb.action.regulate.targets import Step
from feltmb.graphics.viewer.content import output_label, outputs_of
from feltmb.graphics.viewer.html_page import policy, script_of, script_text
from feltmb.live.knobs import Bench, Knob
from feltmb.live.pictures import first_run, greeting, playable
from feltmb.live.request_queue import target_row
from feltmb.live.states import LONGEST
from feltmb.mechanism import Action, describe, load_action
from feltmb.mechanism.workshop import distance_from_joint
from feltmb.params import names
from feltmb.run.results import Run
from feltmb.run.stroke import load_stroke
from unmodeled.arguments import checked
from unmodeled.errors import Error, InvalidParameter
from unmodeled.files import check_suffix, check_writable, read_input, write_text
from unmodeled.style import reader_unit

Array = npt.NDArray[np.float64]

#: The core as a WebAssembly module, beside the extension.
MODULE = Path(_core.__file__).parent / "_core_page.wasm"
#: Largest module that is read [bytes].
MOST_MODULE = 16 * 1024 * 1024
#: Largest relative error of a number in a page that a knob changes; a file has 12 digits.
SAME = 1e-9


@checked
def export_page(action: Action | str | Path, path: str | Path, *, force: bool = False) -> Path:
    """Write a mechanism as one HTML file in which it can be changed and simulated.

    The file contains the mechanism, the core as a WebAssembly module, and the live page. It needs a
    browser, and neither network nor installation. Its numbers are those of :func:`simulate` but for
    rounding of elementary functions. Regulation by itself, weights of the touch and the diagnosis
    need ``feltmb live``.

    Parameters
    ----------
    action
        Object, or name for :func:`load_action`.
    path
        File with the suffix ``.html``.
    force
        Replace an existing file.

    Returns
    -------
    Path
        The written file.

    Raises
    ------
    InvalidParameter
        The module is not there, or one of the laws of the mechanism is a compiled function.
    FileExists
        The file exists and ``force`` is false.
    """
    path = Path(path)
    check_suffix(path, ".html")
    check_writable(path, force=force)
    if not isinstance(action, Action):
        action = load_action(action)
    if not MODULE.is_file():
        raise InvalidParameter(
            f"page: {MODULE.name} is not installed beside the extension of feltmb; hint: "
            "bash tools/wasm.sh in a clone of feltmb builds it (it names what it needs)"
        )
    module = base64.b64encode(read_input(MODULE, most=MOST_MODULE)).decode("ascii")
    return write_text(path, _page(content_of(action), module), force=force)


def worker_script() -> str:
    """Script of the worker: it simulates and makes the pictures."""
    packing = resources.files("feltmb.graphics.viewer") / "assets" / "packing.js"
    return packing.read_text(encoding="utf-8") + _asset("engine.js") + _asset("worker.js")


def _asset(name: str) -> str:
    return (resources.files("feltmb.live") / "assets" / name).read_text(encoding="utf-8")


def _page(content: dict[str, Any], module: str) -> str:
    scripts = [_asset("uPlot.iife.min.js"), script_of(_asset("live.js"), _asset("local.js"))]
    style = resources.files("feltmb.graphics.viewer") / "assets" / "viewer.css"
    styles = [_asset("uPlot.min.css"), style.read_text(encoding="utf-8"), _asset("live.css")]
    data = [
        f'<script type="application/json" id="content">{script_text(content)}</script>',
        f'<script type="text/plain" id="engine">{worker_script()}</script>',
        f'<script type="text/plain" id="module">{module}</script>',
    ]
    rules = html.escape(policy(*scripts, simulates=True))
    inside = {
        '<link rel="icon" href="assets/icon.svg">\n': "",
        '<link rel="stylesheet" href="assets/uPlot.css">\n': (
            f'<meta http-equiv="Content-Security-Policy" content="{rules}">\n'
        ),
        '<link rel="stylesheet" href="assets/live.css">': f"<style>\n{''.join(styles)}</style>",
        '<script src="assets/uPlot.js"></script>': "\n".join(data),
        '<script src="assets/live.js"></script>': "\n".join(
            f"<script>{script}</script>" for script in scripts
        ),
        "<title>feltmb live</title>": f"<title>{html.escape(content['hello']['name'])}</title>",
    }
    text = _asset("live.html")
    for place, replacement in inside.items():
        before, found, after = text.partition(place)
        assert found, place
        text = before + replacement + after
    return text


# --- what is in the file -------------------------------------------------------------------------


def content_of(action: Action) -> dict[str, Any]:
    """The mechanism for the worker, ready for JSON.

    Raises
    ------
    InvalidParameter
        A law is a compiled function.
    """
    bench, run = Bench(action), first_run(action)
    description = describe(action.config)
    rows = _core.description_numbers(description)
    places = {row["path"]: i for i, row in enumerate(rows)}
    knobs = {knob.name: _rules(bench, knob, rows, places) for knob in bench.knobs.values()}
    known = {name: rules for name, rules in knobs.items() if rules is not None}
    reading = action.config.reading
    points = action.mechanism.point_names
    strokes = _strokes(action)
    return {
        "archive": _core.write_description(description),
        "paths": [row["path"] for row in rows],
        "units": [row["unit"] for row in rows],
        "first": [row["value"] for row in rows],
        "numbers": places,
        "knobs": known,
        "points": [
            [name, points.index(rule.point), list(rule.direction), rule.travel]
            for name, rule in action.config.events.items()
            if rule.point is not None and rule.travel is not None
        ],
        "events": {
            name: {
                **{k: getattr(rule, k) for k in ("change", "point", "which", "before", "after")},
                "unless": rule.unless,
                "within": rule.within,
                "contacts": rule.contact if isinstance(rule.contact, list) else [rule.contact],
            }
            for name, rule in action.config.events.items()
        },
        "reading": {
            "strike": reading.strike_contact,
            "key": None if reading.key_point is None else points.index(reading.key_point),
            "key_name": reading.key_point,
            "striker": reading.striker
            and {"point": reading.striker.point, "direction": reading.striker.direction},
        },
        "strokes": strokes,
        "targets": [
            _target(action, step) for step in (bench.targets.steps if bench.targets else ())
        ],
        "check_contacts": list(reading.check_contacts),
        "coordinates": list(action.coordinates),
        "outputs": _outputs(run, action),
        "order": _order(action),
        "hello": _hello(bench, greeting(bench, run), rows, known) | {"strokes": list(strokes)},
    }


def _rules(
    bench: Bench, knob: Knob, rows: list[dict[str, Any]], places: dict[str, int]
) -> list[list[float]] | None:
    """Place, scale, exp, add of each number that a knob changes; None if these do not suffice.

    A number that follows from a changed one, and is not in the mechanism file, must be linear.
    """
    first = np.array([row["value"] for row in rows])
    sizes = [size for size in (knob.high, 0.5 * knob.high, knob.low) if size != 0.0]
    moved: list[tuple[float, Array]] = []
    for size in sizes:
        try:
            changed = bench.action.with_values(bench.values({knob.name: size}, {}))
        except Error:
            continue  # beyond what the mechanism permits
        found = _core.description_numbers(describe(changed.config))
        if len(found) != len(rows):
            return None
        moved.append((size, np.array([row["value"] for row in found])))
    if not moved:
        return None
    rules: dict[int, list[float]] = {
        places[c.path]: [places[c.path], c.scale, c.exp, c.add]
        for c in knob.changes
        if c.path in places
    }
    size, values = moved[0]
    for i in map(int, np.flatnonzero(values != first)):
        rules.setdefault(i, [i, 0.0, 0.0, float(values[i] - first[i]) / size])
    for size, values in moved:
        expected = first.copy()
        for i, (_, scale, exp, add) in rules.items():
            expected[i] = first[i] * (1 + scale * size) * np.exp(exp * size) + add * size
        if np.any(np.abs(expected - values) > SAME * np.maximum(np.abs(values), np.abs(first))):
            return None
    return list(rules.values())


def _strokes(action: Action) -> dict[str, Any]:
    if not playable(action):
        return {}
    strokes = {name: load_stroke(name) for name in names("strokes")}
    return {n: s.as_dict() for n, s in strokes.items() if s.duration <= LONGEST}


def _target(action: Action, step: Step) -> dict[str, Any]:
    """A regulation target, and what its measurement needs."""
    spring = None
    if step.spring is not None:
        of = action.config.springs[step.spring]
        arm = distance_from_joint(action.config, of.coordinate, step.point or "")
        spring = {"coordinate": of.coordinate, "name": step.spring, "arm": arm}
    given = ("measure", "contact", "speed", "travel", "stroke", "target", "low", "high")
    return target_row(step) | {k: getattr(step, k) for k in given} | {"spring": spring}


def _outputs(run: Run, action: Action) -> dict[str, Any]:
    """Label, text, practical unit and its factor of every output."""
    out = {}
    for name, output in outputs_of(run, action.config.reading).items():
        factor, unit = reader_unit(output.unit)
        label = output_label(name, output.text)
        out[name] = {"label": label, "text": output.text, "unit": unit, "factor": factor}
    return out


def _order(action: Action) -> dict[str, Any]:
    """Places of what is drawn in the poses of the core."""
    found = _core.move_through(action.mechanism, np.array([action.rest_pose]))
    bodies = [str(n) for n in found["names"]]
    return {
        "bodies": [-1, *(bodies.index(name) for name in action.config.bodies)],
        "names": len(bodies),
        "numbers": [int(n) for n in found["numbers"]],
    }


def _hello(
    bench: Bench,
    found: dict[str, Any],
    rows: list[dict[str, Any]],
    known: dict[str, list[list[float]]],
) -> dict[str, Any]:
    """Greeting of the page, from that of the server, ``found``."""
    missing = [knob["label"] for knob in found["knobs"] if knob["name"] not in known]
    notes = [f"Only feltmb live can change: {', '.join(missing)}."] if missing else []
    return {
        **found,
        "on": "hello",
        "version": _core.__version__,
        "mechanism": bench.action.name,
        "edition": 1,
        "files": [],
        "faults": [],
        "knobs": [knob for knob in found["knobs"] if knob["name"] in known],
        "numbers": [[row["path"], row["value"], row["unit"], row["meaning"]] for row in rows],
        "notes": [*found["notes"], *notes],
    }
