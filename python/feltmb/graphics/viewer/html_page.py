"""The viewer as one HTML file, or as a part of another page."""

from __future__ import annotations

import base64
import hashlib
import html
import math
from collections.abc import Callable, Sequence
from functools import cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feltmb.graphics.plot.readings import named_events
from feltmb.graphics.viewer.content import MOST_RUNS, default_panels, describe
from feltmb.graphics.viewer.curves import Curves
from feltmb.graphics.viewer.packing import json_text
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter
from unmodeled.files import check_suffix, check_writable, write_text

if TYPE_CHECKING:
    from feltmb.run.results import Run

Progress = Callable[[float], object]

#: Scripts for drawing and for the viewer; the live page uses them too.
_SCRIPTS = ("elements.js", "packing.js", "stage.js", "curves.js", "viewer.js")


def _asset(name: str) -> str:
    return (resources.files("feltmb.graphics.viewer") / "assets" / name).read_text(encoding="utf-8")


@checked
def script_of(*parts: str) -> str:
    """Script of a page with viewers: the viewer, and then the script of the page."""
    texts = [*(_asset(name) for name in _SCRIPTS), *parts]
    return '(() => {\n"use strict";\n' + "\n".join(texts) + "})();\n"


@cache
def _script() -> str:
    return script_of()


@cache
def _style() -> str:
    return _asset("viewer.css")


def assets() -> str:
    """Style and script of the viewer, once for a page with one or more :func:`fragment` s."""
    return f"<style>\n{_style()}</style>\n<script>\n{_script()}</script>\n"


@checked
def policy(*scripts: str, simulates: bool = False) -> str:
    """Content security policy of a page: it loads nothing, and only its own scripts run.

    ``simulates``: also the module of the core, in a worker that the page made, and what it gives to
    hear.
    """
    hashes = " ".join(
        "'sha256-" + base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() + "'"
        for s in scripts
    )
    worker = "; worker-src blob:; media-src blob:" if simulates else ""
    hashes += " 'wasm-unsafe-eval'" if simulates else ""
    return (
        f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; base-uri 'none'"
        f"{worker}"
    )


def script_text(data: Any) -> str:
    """JSON that cannot end a script element, for any content of its texts."""
    text = json_text(data)
    for sign in "<>&\u2028\u2029":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return text


@checked
def fragment(
    runs: Run | Curves | Sequence[Run | Curves],
    *,
    names: Sequence[str] | None = None,
    slowness: float = 20.0,
    window: tuple[float, float] | None = None,
    align: str | None = None,
    panels: Sequence[dict[str, Any]] | None = None,
    at: float | None = None,
    progress: Progress | None = None,
) -> str:
    """The viewer of some runs as one HTML element; the page also needs :func:`assets` once.

    Parameters
    ----------
    runs
        One to six runs; all but the first are drawn as outlines over the first one. ``Curves``
        (measured) have no mechanism and are only drawn as curves.
    names
        Names for people; default: mechanism and stroke.
    slowness
        Ratio of the duration of the playback to the real duration; can be changed in the page.
    window
        First and last time [s] that are included; default: all.
    align
        Event, such as ``string_contact_on``, that has the same time in all runs; can be changed in
        the page.
    panels
        Initial panels: each is ``{"title": text, "outputs": [names], "change": bool}``, where
        ``change`` shows the curves relative to their start. Default: chosen from the data of the
        runs.
    at
        Initial time [s].
    progress
        Function that is called with the completed share, 0 to 1.

    Raises
    ------
    InvalidParameter
        An argument is out of range, or a run has fewer than two samples.
    """
    chosen: list[Run | Curves] = list(runs) if isinstance(runs, Sequence) else [runs]
    if not 1 <= len(chosen) <= MOST_RUNS:
        raise InvalidParameter(f"view: got {len(chosen)} runs, expected 1 to {MOST_RUNS}")
    if not (math.isfinite(slowness) and 0.01 <= slowness <= 1e6):
        raise InvalidParameter(f"view: slowness = {slowness:g}, must lie in [0.01, 1e6]")
    if at is not None and not math.isfinite(1e3 * at):
        raise InvalidParameter(f"view: at = {at:g}, expected a time [s]")
    if names is not None and len(names) != len(chosen):
        raise InvalidParameter(f"view: got {len(names)} names of {len(chosen)} runs")
    labels = [str(n) for n in names] if names is not None else _names(chosen)
    count = len(chosen)
    if align is not None:
        _check_event(chosen, labels, align)
    described = [
        describe(
            run,
            label,
            window,
            None if progress is None else (lambda x, i=i: progress((i + x) / count)),  # type: ignore[misc]
        )
        for i, (run, label) in enumerate(zip(chosen, labels, strict=True))
    ]
    data = {
        "title": " and ".join(labels),
        "slowness": slowness,
        "align": (align or "").replace("_", " "),
        "at": None if at is None else 1e3 * at,
        "panels": list(panels) if panels is not None else default_panels(chosen),
        "runs": described,
    }
    return (
        '<div class="feltmb-view" tabindex="0"><script type="application/json">'
        f"{script_text(data)}</script>"
        "<noscript><p>This picture moves: it needs a browser that runs scripts.</p></noscript>"
        "</div>\n"
    )


def _check_event(runs: Sequence[Run | Curves], labels: Sequence[str], event: str) -> None:
    """Raise an error for an event that one of the runs does not have."""
    known = [[] if isinstance(r, Curves) else [n for _, n in named_events(r)] for r in runs]
    missing = [label for label, names in zip(labels, known, strict=True) if event not in names]
    if missing:
        raise InvalidParameter(
            f"view: there is no event {event!r} in {', '.join(missing)}; events are "
            f"{', '.join(known[0]) or 'none'}"
        )


def _names(runs: Sequence[Run | Curves]) -> list[str]:
    """Mechanism and stroke, with a number if two names would be equal."""
    found = []
    for run in runs:
        if isinstance(run, Curves):
            found.append(run.name)
            continue
        stroke = run.provenance.get("stroke")
        name = stroke.get("name", "") if isinstance(stroke, dict) else ""
        parts = [str(run.provenance.get("action", "")), str(name)]
        found.append(" · ".join(p for p in parts if p) or "run")
    return [
        f"{name} ({1 + found[:i].count(name)})" if found.count(name) > 1 else name
        for i, name in enumerate(found)
    ]


@checked
def page(runs: Run | Curves | Sequence[Run | Curves], **options: Any) -> str:
    """The viewer as a complete HTML page that only needs a browser; see :func:`fragment`."""
    body = fragment(runs, **options)
    chosen = list(runs) if isinstance(runs, Sequence) else [runs]
    labels = options.get("names") or _names(chosen)
    script = f"\n{_script()}"
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{html.escape(policy(script))}">
<title>{html.escape(" and ".join(map(str, labels)))}</title>
<style>
body {{ margin: 12px 16px; background: #fff; }}
{_style()}</style>
</head>
<body>
{body}<script>{script}</script>
</body>
</html>
"""


@checked
def view(
    runs: Run | Curves | Sequence[Run | Curves],
    path: str | Path,
    *,
    force: bool = False,
    **options: Any,
) -> Path:
    """Write one HTML file that shows moving runs; it needs neither network nor server.

    Parameters
    ----------
    runs
        One run, or up to six for comparison: simulated and measured, before and after.
    path
        File with the suffix ``.html``.
    force
        Whether an existing file is replaced.
    **options
        As of :func:`fragment`.

    Returns
    -------
    Path
        The written file.

    Raises
    ------
    InvalidParameter
        An argument is out of range, or the file has another suffix.
    FileExists
        The file exists and ``force`` is false.
    """
    path = Path(path)
    check_suffix(path, ".html")
    check_writable(path, force=force)
    return write_text(path, page(runs, **options), force=force)
