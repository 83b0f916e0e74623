"""Pictures of runs and mechanisms.

Every function takes a :class:`~feltmb.results.Run` (or several, or an
:class:`~feltmb.config.Action`) and returns a matplotlib ``Figure`` of its own; nothing is shown and
no global state of matplotlib is touched. Axes carry the units of a reader: ms, mm, N, m/s, mJ. What
a run does not have is left out; a picture of which nothing would be left is refused.
"""

from feltmb.plot.effects import effects
from feltmb.plot.energies import energy, loops
from feltmb.plot.files import PICTURES, save_all
from feltmb.plot.pages import compare, overview
from feltmb.plot.portrait import mechanism
from feltmb.plot.poses import body_poses
from feltmb.plot.readings import run_action
from feltmb.plot.series import contact_forces, finger_force, hammer_speed, motion, string
from feltmb.plot.shapes import Scene, Shape, scene

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
    "hammer_speed",
    "loops",
    "mechanism",
    "motion",
    "overview",
    "run_action",
    "save_all",
    "scene",
    "string",
]
