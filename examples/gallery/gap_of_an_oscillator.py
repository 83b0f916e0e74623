"""A diagnosis of an oscillator whose model has no dry friction, from three records.

The records are those of an oscillator with 0.8 N of dry friction. The model contains mass, spring,
dashpot, and the effects of the library. The diagnosis should name the friction and its magnitude.
"""

import numpy as np
from show import Found, show

from unmodeled import Coordinate, Equations, Parameter, State, diagnose, library
from unmodeled.data import Record, Sensor
from unmodeled.style import BLUE, RED, new_figure, style_axes

FRICTION, NOISE = 0.8, 2e-5  # N, m


def model(dry=0.0):
    """Mass on a spring with a dashpot, and with dry friction if asked for."""

    def rates(_t, x, u, p):
        friction = dry * np.tanh(x.v / 6e-4)
        return (x.v, (u.f - p.k * x.q - p.c * x.v - friction) / p.m)

    return Equations(
        name="oscillator",
        states=[
            State(name="q", unit="m", scale=0.01, start_sd=1e-3),
            State(name="v", unit="m/s", scale=0.1, start_sd=0.01),
        ],
        parameters=[
            Parameter(name="m", value=1.0, sd=0.05, unit="kg"),
            Parameter(name="k", value=400.0, sd=20.0, unit="N/m"),
            Parameter(name="c", value=2.0, sd=1.0, unit="N s/m", lower=0.0),
        ],
        inputs=["f"],
        rates=rates,
        outputs={"q": "q"},
        coordinates=[slide],
    )


slide = Coordinate(name="slide", position="q", speed="v", inertia="m")
effects = (
    library.dry_friction(slide, scale=0.1, speed=0.2),
    library.quadratic_friction(slide, scale=2.5),
    library.polynomial_stiffness(slide, 3, scale=1e4),
    library.offset_force(slide, scale=0.1),
    library.sensor_fault(["q"], "q", "gain"),
)


def records():
    """Three runs of the oscillator with friction, 1 % heavier than the model."""
    from scipy.integrate import solve_ivp

    rng = np.random.default_rng(1)
    time = np.arange(0.0, 1.6, 0.005)
    out = []
    for i, (size, frequency) in enumerate(((6.0, 2.0), (12.0, 4.0), (9.0, 3.0))):
        force = size * np.sin(2 * np.pi * frequency * time) * np.exp(-time)

        def rate(t, y, force=force):
            friction = FRICTION * np.tanh(y[1] / 6e-4)
            return y[1], (np.interp(t, time, force) - 400.0 * y[0] - 2.0 * y[1] - friction) / 1.01

        path = solve_ivp(
            rate,
            (0, time[-1]),
            (0, 0),
            t_eval=time,
            method="LSODA",
            rtol=1e-8,
            atol=1e-10,
            max_step=0.005,
        ).y[0]
        out.append(
            Record(
                name=f"run {i + 1}",
                time=time,
                inputs={"f": force},
                outputs={"q": path + NOISE * rng.standard_normal(time.size)},
                sensors={"q": Sensor(name="q", unit="m", sigma=NOISE)},
            )
        )
    return out


def compute() -> Found:
    """Diagnose, the last run held-out."""
    runs = records()
    report = diagnose(model(), effects, runs, hold_out=["run 3"])
    named = report.named
    size = named[0].magnitude if named else 0.0
    found = Found(f"missing: {named[0].cause if named else report.verdict.value}", size, "N")
    found.data.update(runs=runs, report=report)
    found.check("number of causes named", len(named), 1, 0.0)
    found.check("its size [N]", size, FRICTION, 0.03)
    return found


def draw(found: Found):
    """Held-out record beside the model before and after."""
    report = found.data["report"]
    figure = new_figure(6.0, 3.2)
    ax = figure.subplots()
    channel = report.worst
    names = ["model", "with friction", "noise"]
    values = [channel.held_out_calibrated, channel.held_out_explained, channel.noise]
    values = [1e3 * v for v in values]
    ax.bar(names, values, color=[RED, BLUE, "#999999"], width=0.5)
    for i, value in enumerate(values):
        ax.text(i, value, f"{value:.3f}", ha="center", va="bottom", fontsize=8)
    title = f"{found.name}, {found.value:.2f} N; withheld were {FRICTION} N"
    style_axes(ax, "", "gap on the held-out run [mm]", title)
    return figure


if __name__ == "__main__":
    show(compute, draw)
