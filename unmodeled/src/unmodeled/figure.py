"""Figures that notebooks show; imported at the first plot, because matplotlib is slow."""

from __future__ import annotations

import io

from matplotlib import figure


class Figure(figure.Figure):
    """Figure of matplotlib that a notebook displays, in contrast to a plain ``Figure``."""

    def _repr_png_(self) -> bytes:
        file = io.BytesIO()
        self.savefig(file, format="png")
        return file.getvalue()
