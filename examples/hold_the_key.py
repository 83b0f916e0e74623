"""An own controller holds the key at half dip: 1 kHz, what a haptic key or a robot finger does.

The controller sees the key's place through a sensor of 12 bit over 16 mm, no speed, and may press
with 0 to 20 N. Every step is a millisecond of the whole action.
"""

from __future__ import annotations

import feltmb

STEP = 1e-3  # s
DIP = 9.5e-3  # m, full travel under the finger
BIT = 16e-3 / 4096  # m


class Controller:
    """Proportional, integral, differential; the speed is that of a filtered difference."""

    def __init__(self, target: float):
        self.target, self.sum, self.place, self.speed = target, 0.0, 0.0, 0.0

    def force(self, place: float) -> float:
        """Force of the finger [N] after a look at the key's place [m]."""
        self.speed += 0.3 * ((place - self.place) / STEP - self.speed)
        self.place = place
        error = self.target - place
        wanted = 600.0 * error + self.sum - 25.0 * self.speed
        if 0.0 < wanted < 20.0:  # the integral rests where the motor is at its limit
            self.sum += 3000.0 * error * STEP
        return min(max(wanted, 0.0), 20.0)


def hold(seconds: float = 1.0) -> list[tuple[float, float, float]]:
    """Time [s], place of the key [m] and force [N] of every step."""
    machine = feltmb.Machine("steinway45", events=False)
    controller = Controller(0.5 * DIP)
    seen = []
    while machine.time < seconds - 0.5 * STEP:
        place = round(machine.read("finger.displacement") / BIT) * BIT
        force = controller.force(place)
        machine.advance(STEP, force=force)
        seen.append((machine.time, machine.read("finger.displacement"), force))
    return seen


if __name__ == "__main__":
    course = hold()
    for at in (99, 299, 599, 999):
        time, place, force = course[at]
        print(f"{time:.1f} s: {1e3 * place:5.2f} mm of {500 * DIP:.2f} mm, {force:4.2f} N")
