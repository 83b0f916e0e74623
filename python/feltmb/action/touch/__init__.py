"""Touch of an action: what the finger feels, slowly and in strikes.

Static: a press and a release without inertia at the key front, hence down-weight, up-weight,
friction, balance weight, let-off, key dip and aftertouch. Dynamic: two families of strikes, pressed
(a force that rises within 20 ms and stays) and struck (a finger of constant speed that hits the
key), hence impact speed, travel time and key-bottom time. ``docs/howto/measure_touch.md`` defines
each number.
"""

from __future__ import annotations

from feltmb.action.touch.static import StaticTouch, static_touch
from feltmb.action.touch.strikes import Strike
from feltmb.action.touch.work import Touch, TouchRow, touch

__all__ = ["StaticTouch", "Strike", "Touch", "TouchRow", "static_touch", "touch"]
