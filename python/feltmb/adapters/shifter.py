"""Configurations for a sequence of parameters; only changed entries are recomputed."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping, Sequence

from feltmb.adapters.changes import read_entry, replace_entry
from feltmb.adapters.library import Entry
from feltmb.adapters.variants import changed_config
from feltmb.mechanism import MechanismFile

__all__ = ["Shifter"]

Chosen = Sequence[tuple[Entry, float, float | None]]


class Shifter:
    """:func:`~feltmb.adapters.variants.changed_config` for many similar lists of entries.

    A derivative changes one entry of fifty. The mechanism of the previous list is reused, and only
    the paths of the changed entries are set again, from the values of the file.
    """

    def __init__(self, config: MechanismFile):
        self._file = config
        self._magnitudes: dict[str, float] = {}
        self._config = config
        self._entries: dict[str, Entry] = {}
        self._lock = threading.Lock()

    def config(self, entries: Chosen, conditions: Mapping[str, float | str]) -> MechanismFile:
        """The mechanism with entries of given magnitudes and shapes; unchanged if all are zero.

        Raises
        ------
        InvalidParameter
            A path is not a number.
        """
        plain = [e for e, _, _ in entries if e.insertion is None and not e.shape_path]
        names = [e.name for e in plain]
        paths = {c.path for e in plain for c in e.changes}
        special = [t for t in entries if t[0].insertion is not None or t[0].shape_path]
        mixed = any(c.path in paths for e, _, _ in special for c in e.changes)
        if mixed or len(set(names)) < len(names):
            return changed_config(self._file, entries, conditions)
        magnitudes: dict[str, float] = {}
        by_path: dict[str, list[tuple[Entry, float]]] = {}
        for e, magnitude, _ in entries:
            if e.insertion is not None or e.shape_path:
                continue
            if e.condition is not None:
                magnitude = magnitude * e.condition.factor(conditions)
            if magnitude != 0.0:
                magnitudes[e.name] = magnitude
                for path in {c.path for c in e.changes}:
                    by_path.setdefault(path, []).append((e, magnitude))
        with self._lock:
            last, config = self._magnitudes, self._config
            known = {e.name: e for e in plain} | self._entries
            moved = {n for n in {*magnitudes, *last} if magnitudes.get(n, 0.0) != last.get(n, 0.0)}
            for path in {c.path for n in moved for c in known[n].changes}:
                factor, added = 1.0, 0.0
                for e, magnitude in by_path.get(path, ()):
                    for c in e.changes:
                        if c.path == path:
                            factor *= (1.0 + c.scale * magnitude) * math.exp(c.exp * magnitude)
                            added += c.add * magnitude
                value = read_entry(self._file, path)
                if factor != 1.0 or added != 0.0:
                    value = value * factor + added
                config = replace_entry(config, path, value)
            if not magnitudes:
                config = self._file
            self._magnitudes, self._config = magnitudes, config
            self._entries = {n: known[n] for n in magnitudes}
        return changed_config(config, special, conditions) if special else config
