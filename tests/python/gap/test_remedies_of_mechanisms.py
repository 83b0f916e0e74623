"""A written remedy in the original simulator: the held-out gap is the one that was promised."""

import tomllib

import numpy as np
import pytest

import feltmb
import unmodeled
from unmodeled import Options
from unmodeled.data import Record, Sensor


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def promised(report, name):
    return next(c for c in report.channels if c.name == name).held_out_explained


FRICTION = "bodies.arm.friction.viscous"


@pytest.mark.slow
def test_start_values_close_the_gap_of_an_fmu_in_fmpy(tmp_path, pendulum):
    fmpy = pytest.importorskip("fmpy")
    path = feltmb.export_fmu(pendulum, tmp_path / "p.fmu", hold="zero", parameters="bodies.*")
    time = 4e-3 * np.arange(200)

    def run(force, values):
        table = np.array(list(zip(time, force, strict=True)), [("time", float), ("force", float)])
        seen = fmpy.simulate_fmu(
            str(path),
            start_values=values,
            input=table,
            output=["arm.angle"],
            stop_time=time[-1],
            output_interval=time[1],
        )
        return np.interp(time, seen["time"], seen["arm.angle"])

    measured = []
    for k, role in enumerate(("fit", "fit", "held_out")):
        force = (0.04 + 0.02 * k) * np.sin((9.0 + 2.0 * k) * time) ** 2
        noise = 1e-4 * np.random.default_rng(k).standard_normal(time.size)
        measured.append(
            Record(
                name=f"run{k}",
                time=time,
                inputs={"force": force},
                outputs={"arm.angle": run(force, {FRICTION: 4e-4}) + noise},
                sensors={"arm.angle": Sensor(name="arm.angle", unit="rad", sigma=1e-4)},
                role=role,
            )
        )
    model = unmodeled.fmu(
        path,
        parameters={"bodies.arm.mass": (None, 1e-4, "kg")},
        unknown={FRICTION: "N m s/rad"},
        outputs=["arm.angle"],
        hold="zero",
        workers=1,
    )
    report = model.diagnose(measured, effects=[FRICTION], options=Options(seconds=900.0))
    assert [n.cause for n in report.named] == [FRICTION]
    report.model.write(tmp_path / "values.toml")
    values = tomllib.loads((tmp_path / "values.toml").read_text())["parameters"]
    last = measured[-1]
    left = rms(run(last.inputs["force"], values) - last.outputs["arm.angle"])
    assert left == pytest.approx(promised(report, "arm.angle"), rel=0.02)
    assert left < 0.1 * rms(run(last.inputs["force"], {}) - last.outputs["arm.angle"])
