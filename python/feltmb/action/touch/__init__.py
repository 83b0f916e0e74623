"""Touch of an action: the forces and times that a finger experiences, slowly and in strikes.

Static: a press and a release without inertia at the key front. They give down-weight, up-weight,
friction, balance weight, let-off, key dip and aftertouch. Dynamic: two families of strikes. In
pressed strikes, a force rises within 20 ms and stays constant. In struck strikes, a finger of
constant speed hits the key. They give impact speed, travel time and key-bottom time.
``docs/howto/measure_touch.md`` defines each quantity.
"""

from __future__ import annotations

from feltmb.action.touch.static import Distances, StaticTouch, distances, static_touch
from feltmb.action.touch.strikes import Strike
from feltmb.action.touch.weights import Weights
from feltmb.action.touch.work import Touch, TouchRow, touch

__all__ = [
    "Distances",
    "StaticTouch",
    "Strike",
    "Touch",
    "TouchRow",
    "Weights",
    "distances",
    "static_touch",
    "touch",
]
