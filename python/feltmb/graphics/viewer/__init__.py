"""Runs in a browser: the moving mechanism, its forces, the string and synchronized curves.

:func:`view` writes one HTML file that needs no network and no server. :func:`fragment` and
:func:`assets` put the same viewer into another page. Numbers travel as 16 bit integers: a curve is
shown to 1/5000 of what it spans, a pose to the thickness of a line.
"""

from feltmb.graphics.viewer.curves import Curves, read_curves
from feltmb.graphics.viewer.html_page import (
    assets,
    fragment,
    page,
    policy,
    script_of,
    view,
)

__all__ = ["Curves", "assets", "fragment", "page", "policy", "read_curves", "script_of", "view"]
