"""The thesis's own gap: the numbers of two impacts that its one printed string does not reach.

A record is one impact: its input is the speed of the hammer before it, its outputs are single
numbers. The diagnosis starts from one string and names the impedance of three, which `steinway45`
has since. The numbers are those of table_4_3.toml.

    feltmb gap diagnose examples/thesis_gap/model.py examples/thesis_gap/records/*.csv -o report/
"""

import tomllib
from pathlib import Path

import numpy as np

from feltmb import Error, _core, load_action, simulate
from feltmb.adapters import Entry, effect_of, load_library
from feltmb.adapters.changes import changed_config
from feltmb.adapters.effects import parameter_of
from feltmb.adapters.simulator import Workshop
from feltmb.run.strikes import ONE_STRIKE
from feltmb.run.stroke import load_stroke
from unmodeled import Model

FILE = tomllib.loads((Path(__file__).parent / "table_4_3.toml").read_text(encoding="utf-8"))
ROWS = {row["name"]: row for row in FILE["records"]}
#: The speed of the hammer is set so long before the impact, and simulated for so long [s].
BEFORE, AFTER = 3e-3, 13e-3


class Impacts(Model):
    """A mechanism whose hammer meets string or stop with a given speed."""

    outputs = ("rebound_speed", "max_impact_force", "impact_duration")
    inputs = ("impact_speed",)
    difference_step = 0.05

    def __init__(self, action, tolerances):
        self.name, self.action, self.tolerances = action.name, action, tolerances
        self.units = {"rebound_speed": "m/s", "max_impact_force": "N", "impact_duration": "s",
                      "impact_speed": "m/s"}  # fmt: skip
        self.parameters = tuple(parameter_of(e) for e in tolerances)
        self.contact = action.config.reading.strike_contact
        self.workshop, self.known, self.starts = Workshop(), {}, {}

    def states(self, _included=()):
        """No states: an impact starts at rest."""
        return ()

    def accepts(self, effect):
        """Whether it is an effect of the library."""
        return isinstance(effect.data, Entry) or super().accepts(effect)

    def simulate(self, record, jobs):
        """Both samples of a record have the numbers of its impact."""
        outputs = np.full((jobs.count, record.samples, len(self.outputs)), np.nan)
        for b in range(jobs.count):
            sizes = jobs.magnitudes[b] if jobs.included else ()
            entries = [
                *((e, float(v), None) for e, v in zip(self.tolerances, jobs.theta[b], strict=True)),
                *((c.effect.data, float(v), c.shape)
                  for c, v in zip(jobs.included, sizes, strict=True)),
            ]  # fmt: skip
            row = ROWS[record.name]
            key = repr((record.name, [(e.name, size, shape) for e, size, shape in entries if size]))
            if key not in self.known:
                self.known[key] = self._numbers(
                    row, entries, float(record.inputs["impact_speed"][0])
                )
            found = self.known[key]
            outputs[b] = [found.get(name, np.nan) for name in self.outputs]
        return outputs

    def _numbers(self, row, entries, speed):
        """Numbers of an impact by name; {} if it cannot be simulated."""
        stroke = load_stroke(row["stroke"])
        if stroke.name not in self.starts:
            run = simulate(self.action, stroke, ledger=False, output_rate=100.0)
            self.starts[stroke.name] = run.summary["impact_time"] - BEFORE
        start = self.starts[stroke.name]
        action = self.action.with_values(row["values"]) if "values" in row else self.action
        try:
            v = self.workshop.build(changed_config(action.config, entries, {}))
            before = self._run(v, stroke, list(v.rest), list(v.memory), start)
            n, found, factor = len(v.mechanism.coordinates), {}, 1.0
            for _ in range(3):
                state = np.array(before.end_state)
                state[n : 2 * n] *= factor
                memory = list(before.end_largest_compression)
                found = self._told(self._run(v, stroke.shifted(-start), list(state), memory, AFTER))
                if not found or abs(found["impact_speed"] / speed - 1.0) < 1e-5:
                    break
                factor *= speed / found["impact_speed"]
            return found
        except (Error, RuntimeError):
            return {}

    def _run(self, v, stroke, state, memory, duration):
        options = _core.SimulationOptions()
        options.duration, options.rtol, options.output_rate = duration, 1e-7, 2.0 / duration
        options.ledger = options.diagnose = False
        options.events, options.peak_contacts = True, [self.contact]
        options.finger_reference = v.finger_reference
        return _core.simulate(v.mechanism, stroke.input, options, state, [], None, memory)

    def _told(self, run):
        """First closing of the contact, its last opening within the impact, and the peak."""
        contact = self.action.mechanism.contact_numbers.index(self.contact)
        changes = [(i, t, way) for i, (t, c, _, way) in enumerate(run.events) if c == contact]
        on = next(((i, t) for i, t, way in changes if way > 0), None)
        if on is None:
            return {}
        approach = run.event_approach[:, contact]
        out = {"impact_speed": float(approach[on[0]])}
        off = [(i, t) for i, t, way in changes if way < 0 and on[1] < t <= on[1] + ONE_STRIKE]
        if off:
            out |= {"rebound_speed": -approach[off[-1][0]], "impact_duration": off[-1][1] - on[1]}
        peaks = [force for c, force, _ in run.peaks if c == contact]
        return out | ({"max_impact_force": peaks[0]} if peaks else {})


action = load_action(FILE["action"]).with_values(FILE["values"])
library = load_library(action)
model = Impacts(action, library.choose_tolerances(FILE["tolerances"]))
effects = [effect_of(e, (), {}) for e in library.select(FILE["effects"])]
