"""Cost of exact derivatives in strokes, by the number of columns.

python bench/speed/columns.py [--stroke NAME] [--repeat N]

Columns are those of a diagnosis: tolerances, then effects of the library that bring no states of
their own, up to 10 ms after the strike. Processor time of one pass, whose versions of the mechanism
are known, over that of the stroke alone; the two in turn, the median.
"""

from __future__ import annotations

import argparse
import statistics
import time

import numpy as np

import feltmb
from feltmb.adapters import load_library, mechanism_model
from feltmb.adapters.derivatives import TOLERANCE, added_states, forward_sensitivities
from unmodeled.data import Record
from unmodeled.fit import Candidate, SensitivityRequest

COLUMNS = (10, 50, 200)
#: Time after the strike that is included [s].
AFTER = 0.01


def main() -> None:
    """Print one line for each number of columns."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--stroke", default="forte")
    parser.add_argument("--repeat", type=int, default=5)
    options = parser.parse_args()
    action = feltmb.load_action("steinway45")
    stroke = feltmb.load_stroke(options.stroke)
    impact = feltmb.simulate(action, stroke, ledger=False).summary["impact_time"]
    model, effects = mechanism_model(
        action, library=load_library(action), effects=["all"], workers=1, variation=None
    )
    clock = np.arange(0.0, impact + AFTER, 5e-4)
    zeros = {o: np.zeros(clock.size) for o in model.outputs}
    record = Record(name=stroke.name, time=clock, inputs={"force": stroke.at(clock)}, outputs=zeros)
    candidates = [Candidate(e, s) for e in effects for s in e.shapes]
    candidates = [c for c in candidates if not added_states(model.simulator, record, c)]
    theta = np.zeros(len(model.parameters))
    base = model.simulator.version(record, theta, (), np.zeros(0))

    def strokes() -> None:
        model.simulator.whole(record, base)

    for count in COLUMNS:
        by_theta = range(min(count, len(model.parameters)))
        more = tuple(candidates[: count - len(by_theta)])

        request = SensitivityRequest(record, theta, np.zeros(0), by_theta=by_theta, candidates=more)

        def columns(request: SensitivityRequest = request) -> None:
            forward_sensitivities(model.simulator, request, tolerance=TOLERANCE)

        columns()
        ratios, times = [], []
        for _ in range(options.repeat):
            each = []
            for work in (strokes, columns):
                before = time.process_time()
                work()
                each.append(time.process_time() - before)
            ratios.append(each[1] / each[0])
            times.append(each[1])
        print(
            f"{stroke.name}: {len(by_theta) + len(more)} columns, "
            f"{1e3 * statistics.median(times):.0f} ms, {statistics.median(ratios):.1f} strokes"
        )


if __name__ == "__main__":
    main()
