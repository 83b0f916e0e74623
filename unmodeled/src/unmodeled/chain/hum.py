"""Hum of the mains in a signal."""

import numpy as np

from unmodeled.chain import Fault, register


class Hum(Fault):
    """reading = y + size sin(2 pi 50 Hz t)."""

    name, unit = "hum", ""  # the unit of the signal
    sensor = "The mains are in the signal.", "Shield the cable."
    each = "hum", "Shield the cable."

    def act(self, run, y, size, shape=None):
        return y + size * np.sin(2.0 * np.pi * 50.0 * run.time)

    def fields(self, signal):
        return {"scale": 0.02 * signal.size}


register(Hum())
