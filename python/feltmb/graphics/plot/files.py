"""Writes all plots of a run to files."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

from feltmb.graphics.plot.energies import energy, loops
from feltmb.graphics.plot.pages import overview
from feltmb.graphics.plot.portrait import moment_of_run
from feltmb.graphics.plot.series import contact_forces, finger_force, motion, striker_speed, string
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter
from unmodeled.files import check_writable, is_folder, make_folder, write_file

if TYPE_CHECKING:
    from feltmb.run.results import Run

#: Samples per second with which the loop of a contact of 1 ms is drawn as a curve [Hz].
SMOOTH_RATE = 40_000.0
#: Samples of a run above which pictures of long runs get fewer per second.
MOST_SAMPLES = 200_000

#: Plots that :func:`save_all` writes.
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


@checked
def picture_rate(duration: float, least: float) -> float:
    """Output rate [Hz] of a run that is drawn: a contact of 1 ms has 40 samples.

    Parameters
    ----------
    duration
        Simulated time [s]; runs longer than 5 s get fewer samples per second.
    least
        Rate without pictures [Hz].
    """
    return max(least, min(SMOOTH_RATE, MOST_SAMPLES / duration)) if duration > 0.0 else least


@checked
def save_all(run: Run, folder: str | Path, stem: str, force: bool = False) -> list[Path]:
    """Write every plot for which the run has data, as ``folder/stem_PLOT.png``.

    Parameters
    ----------
    run
        Run that is drawn.
    folder
        Folder of the plots.
    stem
        Beginning of the file names.
    force
        False: an existing file is not overwritten.

    Returns
    -------
    list of Path
        The written files.

    Raises
    ------
    FileExists
        One of the files exists and ``force`` is false; then nothing is written.
    InvalidParameter
        The run has no data for any plot.
    """
    folder = Path(folder)
    pictures: dict[Path, bytes] = {}
    for name, draw in PICTURES.items():
        path = folder / f"{stem}_{name}.png"
        if is_folder(folder):
            check_writable(path, force=force)
        drawn = io.BytesIO()
        try:
            draw(run).savefig(drawn)
        except InvalidParameter:
            continue
        pictures[path] = drawn.getvalue()
    if not pictures:
        raise InvalidParameter("plot: the run has data for no picture")
    make_folder(folder)
    for path, data in pictures.items():
        write_file(path, lambda target, data=data: target.write_bytes(data), force=force)  # type: ignore[misc]
    return list(pictures)
