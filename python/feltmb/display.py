"""Display of objects in a notebook: a small HTML table, a figure."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, cast

from unmodeled.lazy import lazy_import

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def short_number(value: object) -> str:
    """Number with four digits; a text is unchanged."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def html_table(title: str, head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Table in HTML; all texts are escaped.

    Parameters
    ----------
    title
        Caption of the table.
    head
        Heading of each column.
    rows
        Cells of each row. Floats are shown with four digits.
    """

    def line(cells: Sequence[object], tag: str) -> str:
        inner = "".join(f"<{tag}>{html.escape(short_number(c))}</{tag}>" for c in cells)
        return f"<tr>{inner}</tr>"

    body = "".join(line(row, "td") for row in rows)
    caption = f'<caption style="text-align: left">{html.escape(title)}</caption>'
    return f"<table>{caption}<thead>{line(head, 'th')}</thead><tbody>{body}</tbody></table>"


def picture(name: str, *arguments: Any) -> Figure:
    """Figure of the function ``name`` in ``feltmb.graphics.plot``."""
    return cast("Figure", lazy_import(f"feltmb.graphics.plot:{name}")(*arguments))
