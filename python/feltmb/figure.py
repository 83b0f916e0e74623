"""Figures that notebooks show; imported where a picture is drawn, for matplotlib takes its time."""

from __future__ import annotations

import io

from matplotlib import figure

__all__ = ["Figure"]


class Figure(figure.Figure):
    """Figure of matplotlib; a notebook shows only those of ``pyplot`` by itself."""

    def _repr_png_(self) -> bytes:
        file = io.BytesIO()
        self.savefig(file, format="png")
        return file.getvalue()
