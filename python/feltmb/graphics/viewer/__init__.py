"""Runs in a browser: the moving mechanism, its forces, the string, and synchronized curves.

:func:`view` writes one HTML file that needs neither network nor server. :func:`fragment` and
:func:`assets` put the same viewer into another page. Numbers are stored as 16 bit integers: the
error of a curve is 1/5000 of its range, and that of a pose is the thickness of a line.
"""

from feltmb.graphics.viewer.curves import Curves, read_curves, read_each_run
from feltmb.graphics.viewer.html_page import (
    assets,
    fragment,
    page,
    policy,
    script_of,
    view,
)

__all__ = [
    "Curves",
    "assets",
    "fragment",
    "page",
    "policy",
    "read_curves",
    "read_each_run",
    "script_of",
    "view",
]
