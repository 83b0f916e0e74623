"""Causes that the library of effects does not hold. Whoever writes the library need not look.

A kind has ``name``, ``component``, ``onset`` (start, key, bed, string, letoff, check), ``size``
(a magnitude that is worth trying first) and at least one of

``force(t, x, v, h, w, contacts, magnitude, memory, dt) -> (on the key, on the hammer)``
    Forces [N] at the time t for a batch of strokes; ``contacts`` holds forces by name; ``memory``
    (8, n) starts at zero and may be written to.
``observe(times, key, hammer, magnitude, rng) -> (key, hammer)``
    What the cameras see.
"""

from __future__ import annotations

from typing import Any

import numpy as np

Forces = tuple[Any, Any]


class SecondLayer:
    """A dense layer below the bed felt: hard once the felt is pressed by 0.35 mm."""

    name, component, onset, size = "second_layer", "bed felt", "bed", 3e3

    def force(self, t, x, v, h, w, contacts, size, memory, dt) -> Forces:  # type: ignore[no-untyped-def]
        return -size * np.maximum(x - 9.95e-3, 0.0), 0.0


class TightSpot:
    """The hammer's center rubs between 15 and 25 mm only."""

    name, component, onset, size = "tight_spot", "hammer pivot", "key", 0.05

    def force(self, t, x, v, h, w, contacts, size, memory, dt) -> Forces:  # type: ignore[no-untyped-def]
        return 0.0, -size * np.exp(-(((h - 20e-3) / 4e-3) ** 2)) * np.tanh(w / 0.02)


class Frame:
    """The key frame rings at 45 Hz when the key meets the bed, and shakes the hammer rail."""

    name, component, onset, size = "frame_ringing", "key frame", "bed", 0.02

    def force(self, t, x, v, h, w, contacts, size, memory, dt) -> Forces:  # type: ignore[no-untyped-def]
        omega = 2.0 * np.pi * 45.0
        memory[1] += dt * (omega**2 * (contacts["bed"] - memory[0]) - 0.06 * omega * memory[1])
        memory[0] += dt * memory[1]
        return 0.0, size * memory[0]


class StringEcho:
    """The string's wave comes back after 4 ms and kicks a hammer that is still near."""

    name, component, onset, size = "string_echo", "string", "string", 0.1

    def force(self, t, x, v, h, w, contacts, size, memory, dt) -> Forces:  # type: ignore[no-untyped-def]
        # A chain of four lags of 1 ms is a delay of 4 ms.
        memory[0] += dt / 1e-3 * (contacts["string"] - memory[0])
        for k in range(1, 4):
            memory[k] += dt / 1e-3 * (memory[k - 1] - memory[k])
        return 0.0, -size * memory[3] * np.exp(-(((h - 45e-3) / 10e-3) ** 2))


class Damper:
    """The damper is lifted from half of the key's travel on, with its spring's preload."""

    name, component, onset, size = "damper_lift", "damper", "key", 0.3

    def force(self, t, x, v, h, w, contacts, size, memory, dt) -> Forces:  # type: ignore[no-untyped-def]
        return -size * (0.5 + 0.5 * np.tanh((x - 4.8e-3) / 2e-4)) * (1.0 + 20.0 * x), 0.0


class LooseLead:
    """A loose lead weight rattles in the key."""

    name, component, onset, size = "loose_lead", "key", "key", 0.3

    def force(self, t, x, v, h, w, contacts, size, memory, dt) -> Forces:  # type: ignore[no-untyped-def]
        # 2 g on a hard support 0.3 mm wide; memory: place and speed against the key's.
        mass, play = 2e-3, 0.3e-3
        gap = memory[0] - x
        f = 3e3 * (np.maximum(gap - play, 0.0) - np.maximum(-gap, 0.0))
        f = f + 0.5 * (memory[1] - v) * (f != 0.0)
        memory[1] += dt * (9.81 * 0.2 - f / mass)
        memory[0] += dt * memory[1]
        return size * f, 0.0


class StickyJack:
    """Graphite gone sticky: jack and butt pull at each other for the first millimeter apart."""

    name, component, onset, size = "sticky_jack", "jack", "key", 0.3

    def force(self, t, x, v, h, w, contacts, size, memory, dt) -> Forces:  # type: ignore[no-untyped-def]
        apart = h - 5.0 * x
        pull = size * np.where(apart > 0.0, np.maximum(apart, 0.0) / 3e-4, 0.0)
        pull = pull * np.exp(-np.maximum(apart, 0.0) / 3e-4)
        return 5.0 * pull, -pull


class WarmingFelt:
    """The hammer's resistance rises in the course of a record, as a warming center does."""

    name, component, onset, size = "warming_center", "hammer pivot", "key", 0.1

    def force(self, t, x, v, h, w, contacts, size, memory, dt) -> Forces:  # type: ignore[no-untyped-def]
        return 0.0, -size * w * (t / 0.1) ** 2


class ShakingCamera:
    """The hammer's camera shakes at 70 Hz once the key has hit the bed."""

    name, component, onset, size = "shaking_camera", "hammer camera", "bed", 1e-4

    def observe(self, times, key, hammer, size, rng):  # type: ignore[no-untyped-def]
        hit = np.flatnonzero(key > 9.7e-3)
        start = times[hit[0]] if hit.size else times[-1]
        since = np.maximum(times - start, 0.0)
        shake = np.sin(2.0 * np.pi * 70.0 * since) * np.exp(-since / 0.05)
        return key, hammer + size * shake


class LensDistortion:
    """A barrel-shaped image of the hammer: bent in the middle, true at both ends."""

    name, component, onset, size = "lens_distortion", "hammer camera", "key", 3e-4

    def observe(self, times, key, hammer, size, rng):  # type: ignore[no-untyped-def]
        s = hammer / 45e-3
        return key, hammer + size * np.sin(2.0 * np.pi * np.clip(s, 0.0, 1.0))


KINDS = (
    SecondLayer(), TightSpot(), Frame(), StringEcho(), Damper(), LooseLead(), StickyJack(),
    WarmingFelt(), ShakingCamera(), LensDistortion(),
)  # fmt: skip
