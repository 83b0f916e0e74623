"""All pictures of a run as files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from feltmb.errors import InvalidParameter
from feltmb.files import check_writable, make_folder, write_file
from feltmb.graphics.plot.energies import energy, loops
from feltmb.graphics.plot.pages import overview
from feltmb.graphics.plot.portrait import moment_of_run
from feltmb.graphics.plot.series import contact_forces, finger_force, motion, striker_speed, string

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from feltmb.run.results import Run

__all__ = ["PICTURES", "save_all"]

#: Pictures that :func:`save_all` writes.
PICTURES = {
    "overview": overview,
    "motion": motion,
    "striker_speed": striker_speed,
    "contact_forces": contact_forces,
    "finger_force": finger_force,
    "string": string,
    "energy": energy,
    "loops": loops,
    "mechanism": moment_of_run,
}


def save_all(run: Run, folder: str | Path, stem: str, force: bool = False) -> list[Path]:
    """Write every picture that the run has data for, as ``folder/stem_PICTURE.png``.

    Parameters
    ----------
    run
        Run that is drawn.
    folder
        Folder of the pictures.
    stem
        Beginning of the file names.
    force
        False: an existing file is not overwritten.

    Returns
    -------
    list of Path
        The files written.

    Raises
    ------
    FileExists
        One of the files exists and ``force`` is not given; nothing is written then.
    InvalidParameter
        The run has data for no picture.
    """
    folder = make_folder(folder)
    figures: dict[Path, Figure] = {}
    for name, draw in PICTURES.items():
        path = folder / f"{stem}_{name}.png"
        check_writable(path, force=force)
        try:
            figures[path] = draw(run)
        except InvalidParameter:
            continue
    if not figures:
        raise InvalidParameter("plot: the run has data for no picture")
    for path, figure in figures.items():
        write_file(path, lambda target, f=figure: f.savefig(target), force=force)  # type: ignore[misc]
    return list(figures)
