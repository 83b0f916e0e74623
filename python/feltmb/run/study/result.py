"""Result of a study: table, findings, figures, files."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feltmb.arguments import checked
from feltmb.files import check_writable, make_folder, write_file, write_text
from feltmb.run.study.model import Study
from feltmb.run.study.outcomes import FindingResult, StudyOutcomes
from feltmb.run.study.page import page as page_of
from feltmb.run.study.plot import draw, png

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["FindingResult", "StudyResult", "study_targets"]


@dataclass(frozen=True, eq=False, repr=False)
class StudyResult(StudyOutcomes):
    """Result of a study.

    Attributes
    ----------
    study : Study
        The study.
    outcomes : dict
        Outcome by :class:`Case`.
    """

    _cache: dict[str, Any] = field(default_factory=dict, repr=False)

    @property
    def figures(self) -> dict[str, Figure]:
        """Figures by name, as matplotlib ``Figure``; they are plotted at the first access."""
        for name in self.study.spec.figures:
            if name not in self._cache:
                self._cache[name] = draw(self, name)
        return {name: self._cache[name] for name in self.study.spec.figures}

    def html(self) -> str:
        """One self-contained page."""
        return page_of([self])

    @checked
    def save(self, folder: str | Path, *, force: bool = False, page: bool = True) -> list[Path]:
        """Write NAME.html, NAME.csv (SI units), NAME.json and the figures as PNG to a folder.

        Parameters
        ----------
        page
            Whether the HTML page is written.
        """
        make_folder(folder)
        paths = [p for p in study_targets(self.study, folder) if page or p.suffix != ".html"]
        for path in paths:
            check_writable(path, force=force)
        written = []
        for path in paths:
            if path.suffix == ".html":
                text = self.html()
            elif path.suffix == ".csv":
                text = self.table.to_csv(index=False)
            elif path.suffix == ".json":
                text = json.dumps(self.as_dict(), indent=2, sort_keys=True) + "\n"
            else:
                continue
            written.append(write_text(path, text, force=force))
        for name in self.study.spec.figures:
            data, path = png(self, name), Path(folder) / f"{self.study.name}_{name}.png"
            written.append(write_file(path, partial(_write_bytes, data), force=force))
        return written


def _write_bytes(data: bytes, target: Path) -> None:
    target.write_bytes(data)


@checked
def study_targets(made: Study, folder: str | Path) -> list[Path]:
    """Files that ``StudyResult.save`` writes for a study."""
    where = Path(folder)
    return [where / f"{made.name}.{suffix}" for suffix in ("html", "csv", "json")] + [
        where / f"{made.name}_{key}.png" for key in made.spec.figures
    ]
