"""Values of a sweep: axes, ranges, points, and the paths that get the values."""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from feltmb.run.options import OPTIONS, check_options
from feltmb.run.stroke import Stroke
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter, shown


def _is_finite(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    return abs(value) <= sys.float_info.max


def _number(path: str, value: object) -> float:
    if not _is_finite(value):
        raise InvalidParameter(f"{path}: got {shown(value)}, expected a finite number")
    return float(value)  # type: ignore[arg-type]


How = Literal["set", "scale", "offset"]


@checked
@dataclass(frozen=True)
class Axis:
    """One axis of a sweep.

    Attributes
    ----------
    path
        Dotted path that gets the value, and column of the table: a path of the mechanism,
        ``stroke.scale``, ``stroke.delay`` or ``options.NAME``.
    values
        Values of the axis.
    how
        ``set`` replaces the value of the mechanism, ``scale`` multiplies it, ``offset`` is added to
        it.
    """

    path: str
    values: tuple[Any, ...]
    how: How = "set"

    def at(self, value: Any) -> dict[str, Any]:
        """Values and changes by path for one value of the axis, as for ``Action.with_values``."""
        if self.how == "set":
            return {self.path: value}
        if self.how == "offset" and isinstance(value, str):
            return {f"{self.path} +=": value}
        if not _is_finite(value):
            raise InvalidParameter(
                f"axis {self.path!r}: got {shown(value)}, expected a finite number to {self.how} by"
            )
        if self.how == "offset":
            return {f"{self.path} +=": value}
        return {f"{self.path} *=": value}


@checked
def axis_values(given: Any, where: str) -> tuple[tuple[Any, ...], How]:
    """Values of an axis, given as a sequence or a table; see :func:`sweep`."""
    how: How = "set"
    if isinstance(given, Mapping):
        for word in ("scale", "offset"):
            if word in given:
                if len(given) > 1:
                    raise InvalidParameter(f"{where}: {word} stands alone")
                values, inner = axis_values(given[word], where)
                if inner != "set":
                    raise InvalidParameter(f"{where}: scale and offset do not nest")
                return values, word
        unknown = set(given) - {"from", "to", "count", "spacing"}
        if unknown or not {"from", "to", "count"} <= set(given):
            raise InvalidParameter(
                f"{where}: got keys {', '.join(map(str, given))}; a range has from, to, count "
                "and spacing = 'linear' or 'log'"
            )
        return _range(given, where), how
    if isinstance(given, (str, bytes)) or not isinstance(given, Iterable):
        raise InvalidParameter(f"{where}: got {shown(given)}, expected a list of values or a range")
    dimensions = getattr(given, "ndim", 1)
    if dimensions != 1:
        raise InvalidParameter(f"{where}: got an array of {dimensions} dimensions, expected 1")
    values = tuple(v.item() if hasattr(v, "item") else v for v in given)
    if not values:
        raise InvalidParameter(f"{where}: has no values")
    return values, how


MOST_POINTS = 1_000_000  # largest number of points of a sweep, and of values of an axis


def _range(given: Mapping[str, Any], where: str) -> tuple[float, ...]:
    import numpy as np

    start, end, count = given["from"], given["to"], given["count"]
    spacing = given.get("spacing", "linear")
    if (
        not (_is_finite(start) and _is_finite(end))
        or not isinstance(count, int)
        or not 1 <= count <= MOST_POINTS
    ):
        raise InvalidParameter(
            f"{where}: from = {shown(start)}, to = {shown(end)}, count = {shown(count)}; expected "
            f"two numbers and a count of 1 to {MOST_POINTS}"
        )
    if spacing == "linear":
        return tuple(float(v) for v in np.linspace(start, end, count))
    if spacing == "log" and start > 0 and end > 0:
        return tuple(float(v) for v in np.geomspace(start, end, count))
    raise InvalidParameter(
        f"{where}: spacing = {spacing!r}, expected linear, or log between positive numbers"
    )


@checked
def grid_points(axes: Sequence[Axis], mode: Literal["grid", "list"]) -> Iterator[tuple[Any, ...]]:
    """Combinations of the values of the axes, last axis fastest; ``list``: pairs by index."""
    if mode == "grid":
        size = math.prod(len(axis.values) for axis in axes)
        if size > MOST_POINTS:
            raise InvalidParameter(f"sweep: a grid of {size} points; the limit is {MOST_POINTS}")
        return itertools.product(*(axis.values for axis in axes))
    if len({len(axis.values) for axis in axes}) > 1:
        lengths = ", ".join(f"{axis.path}: {len(axis.values)}" for axis in axes)
        raise InvalidParameter(f"sweep: a list needs axes of the same length, got {lengths}")
    return zip(*(axis.values for axis in axes), strict=True) if axes else iter([()])


@checked
def apply_point(
    stroke: Stroke, options: Mapping[str, Any], values: Mapping[str, Any]
) -> tuple[dict[str, Any], Stroke, dict[str, Any]]:
    """Divide values by path into those of the mechanism, the stroke and the options."""
    mechanism: dict[str, Any] = {}
    chosen = dict(options)
    for path, value in values.items():
        head, _, rest = path.partition(".")
        if head == "options":
            check_options({rest: value}, known=OPTIONS)
            chosen[rest] = value
        elif head == "stroke":
            if rest == "scale":
                stroke = stroke.scaled(_number(path, value))
            elif rest == "delay":
                stroke = stroke.shifted(_number(path, value))
            elif rest == "duration":
                stroke = replace(stroke, duration=_number(path, value))
            else:
                raise InvalidParameter(
                    f"path {path!r}: of a stroke there are stroke.scale, .delay, .duration"
                )
        else:
            mechanism[path] = value
    return mechanism, stroke, chosen
