"""Figures of runs and mechanisms.

Every function takes a :class:`~feltmb.run.results.Run` (or several, or an
:class:`~feltmb.mechanism.Action`) and returns a new matplotlib ``Figure``. It shows nothing and
does not change the global state of matplotlib. Axes have practical units: ms, mm, N, m/s, mJ. Parts
for which the run has no data are omitted. If nothing remains, an error is raised.
"""

from feltmb.graphics.plot.effect_bars import effects
from feltmb.graphics.plot.energies import energy, loops
from feltmb.graphics.plot.files import PICTURES, picture_rate, save_all
from feltmb.graphics.plot.pages import compare, overview
from feltmb.graphics.plot.portrait import mechanism
from feltmb.graphics.plot.poses import body_poses
from feltmb.graphics.plot.readings import run_action
from feltmb.graphics.plot.series import contact_forces, finger_force, motion, striker_speed, string
from feltmb.graphics.plot.shapes import Scene, Shape, scene

__all__ = [
    "PICTURES",
    "Scene",
    "Shape",
    "body_poses",
    "compare",
    "contact_forces",
    "effects",
    "energy",
    "finger_force",
    "loops",
    "mechanism",
    "motion",
    "overview",
    "picture_rate",
    "run_action",
    "save_all",
    "scene",
    "striker_speed",
    "string",
]
