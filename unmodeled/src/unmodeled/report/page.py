"""The report as one page that loads nothing: sentence, motions, evidence, details."""

from __future__ import annotations

import base64
import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from importlib import resources
from typing import TYPE_CHECKING, Any

import numpy as np

from unmodeled.data import Array
from unmodeled.pictures.curves import Law, Motion, Motions
from unmodeled.report.figures import axis_unit, evidence, motion, raised, svg
from unmodeled.report.words import percent

if TYPE_CHECKING:
    from markupsafe import Markup

#: Digits of the values of curves.
DIGITS = 4


def render_page(template: str, *, package: str = "unmodeled.report", **values: object) -> str:
    """A page from a template of a package; all texts are escaped, but not ``Markup``."""
    import jinja2

    text = (resources.files(package) / template).read_text(encoding="utf-8")
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.from_string(text).render(**values)


def page(motions: Motions | None, laws: Sequence[Law], **values: Any) -> str:
    """The page of a report.

    Parameters
    ----------
    motions
        Motions of the records; None: they are not known.
    laws
        Evidence of the changes.
    values
        Other values of the template.
    """
    from markupsafe import Markup

    script = (resources.files("unmodeled.report") / "report.js").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    alive: dict[str, Any] = {"data": "", "records": (), "still": ""}
    if motions is not None:
        alive = {
            "data": Markup(_data(motions)),
            "records": [_title(m) for m in motions.whole],
            "still": Markup(svg(motion(motions), "measured, as it is, and with the changes")),
        }
    return render_page(
        "report.html",
        script=Markup(script),
        digest=digest,
        motions=motions,
        laws=[_picture(law) for law in laws],
        **alive,
        **values,
    )


def _picture(law: Law) -> Markup:
    from markupsafe import Markup

    return Markup(svg(evidence([law], key=False), f"evidence of {law.title}"))


def _title(m: Motion) -> str:
    return f"{m.channel} of {m.record}{', held out' if m.held_out else ''}"


def _data(motions: Motions) -> str:
    """What the script of the page reads, as JSON without a letter that ends a script."""
    own = (motions.chosen, *motions.whole)
    scales = [axis_unit(m.measured, unit=m.unit) for m in own]
    known: Mapping[str, float] = {m.channel: m.motion for m in motions.whole}
    whole = {
        "motions": [
            _curves(m, *scale, k) for k, (m, scale) in enumerate(zip(own, scales, strict=True))
        ],
        "all": len(motions.alternatives) == 2 ** len(motions.changes),
        "alternatives": [
            {
                "kept": list(a.kept),
                "left": {n: _share(v, known.get(n, 0.0)) for n, v in a.left.items()},
                "curves": [
                    _numbers(factor * y) for (factor, _), y in zip(scales, a.curves, strict=True)
                ],
            }
            for a in motions.alternatives
        ],
    }
    return json.dumps(whole, separators=(",", ":")).replace("<", "\\u003c")


def _curves(m: Motion, factor: float, unit: str, place: int) -> dict[str, Any]:
    clock, second = axis_unit(m.time, unit="s")
    part = "The part that the changes change most: " * (place == 0)
    return {
        "title": f"{part}{_title(m)}",
        "channel": m.channel,
        "unit": "" if unit in ("", "1") else f" [{raised(unit)}]",
        "clock": f" [{second}]",
        "t": _numbers(clock * m.time, DIGITS + 2),
        "measured": _numbers(factor * m.measured),
        "asis": _numbers(factor * m.tabulated),
        "with": _numbers(factor * m.changed),
    }


def _share(left: float, motion: float) -> str | None:
    return percent(left / motion) if math.isfinite(left) and motion > 0.0 else None


def _numbers(values: Array, digits: int = DIGITS) -> list[float | int | None]:
    """Values with few digits of the largest one; None: not a number."""
    most = float(np.nanmax(np.abs(values), initial=0.0)) or 1.0
    if not math.isfinite(most):
        return [None] * len(values)
    places = digits - 1 - math.floor(math.log10(most))
    found = np.round(values, places)
    return [
        None if not math.isfinite(v) else int(v) if v.is_integer() else v for v in found.tolist()
    ]
