"""Two records with two clocks become one."""

import numpy as np
import pytest

import unmodeled
from unmodeled.cli import main
from unmodeled.data import Record, Sensor, fit_clocks, join_records, read_record, write_record
from unmodeled.errors import DataError, InvalidParameter
from unmodeled.models.model import prior_jobs
from unmodeled.search.compare import join_by_motion

OFFSET, RATE = 1.25, 1.0005


def force(t):
    return 3.0 * np.sin(20.0 * t)


def camera(**changes):
    t = np.arange(0.0, 0.5, 2e-3)
    given = {
        "name": "camera",
        "time": t,
        "inputs": {},
        "outputs": {"y": 1e-3 * t},
        "sensors": {"y": Sensor(name="y", unit="m", sigma=1e-5)},
    }
    return Record(**(given | changes))


def cell(low=0.1, high=0.4, step=1e-4, **changes):
    t = np.arange(low, high, step)  # time on the clock of the camera
    given = {
        "name": "cell",
        "time": OFFSET + RATE * t,
        "inputs": {},
        "outputs": {"Load": force(t)},
        "sensors": {"Load": Sensor(name="Load", unit="N")},
    }
    return Record(**(given | changes))


EVENTS = [(t, OFFSET + RATE * t) for t in (0.15, 0.35)]


def test_the_force_is_that_of_the_time_of_the_camera():
    both = join_records(camera(), cell(), same=EVENTS)
    assert both.time[0] == pytest.approx(0.1)
    assert both.time[-1] == pytest.approx(0.4, abs=2.1e-3)
    np.testing.assert_allclose(both.inputs["force"], force(both.time), atol=1e-5)
    np.testing.assert_array_equal(both.outputs["y"], 1e-3 * both.time)
    assert both.sensors["y"].sigma == 1e-5
    assert both.input_units == {"force": "N"}
    assert both.input_mode == "force"
    told = "; ".join(both.notes)
    assert "interpolated linearly" in told
    assert "1250 ms" in told
    assert "which is 500 ppm faster" in told
    assert "Load is the input force" in told
    assert "1250 ms" in both.source


def test_one_event_gives_the_offset_only():
    (one,) = EVENTS[:1]
    clocks = fit_clocks([one])
    assert clocks.rate == 1.0
    assert clocks.offset == pytest.approx(one[1] - one[0])
    assert fit_clocks([]).second(np.array([2.0])) == 2.0
    three = fit_clocks([(0.0, 1.0), (1.0, 2.001), (2.0, 3.0)])
    assert three.residual == pytest.approx(2e-3 / 3.0, rel=1e-6)


def test_missing_outputs_stay_missing_and_inputs_can_be_chosen():
    holes = cell().outputs["Load"].copy()
    holes[500:600] = np.nan
    laser = {"Load": holes, "laser": np.zeros_like(holes)}
    sensors = {"Load": Sensor(name="Load", unit="N"), "laser": Sensor(name="laser", unit="m")}
    other = cell(outputs=laser, sensors=sensors)
    both = join_records(camera(), other, same=EVENTS, inputs={"displacement": "laser"})
    assert both.input_mode == "motion"
    missing = np.isnan(both.outputs["Load"])
    assert 0 < missing.sum() <= 6
    assert np.all((both.time[missing] > 0.149) & (both.time[missing] < 0.161))
    with pytest.raises(DataError, match="force"):  # an input must be complete
        join_records(camera(), other, same=EVENTS)
    with pytest.raises(InvalidParameter, match="no channel 'lasre'; near are laser"):
        join_records(camera(), cell(outputs=laser, sensors=sensors), inputs={"x": "lasre"},
                     same=EVENTS)  # fmt: skip


def test_the_sensor_of_a_channel_that_becomes_an_input_is_used():
    late = 0.02
    sensor = Sensor(name="Load", unit="N", sigma=0.03, colored_sigma=0.04, correlation_time=1e-3,
                    quantum=0.12, delay=late, gain=2.0, offset=0.5, gain_sd=0.01)  # fmt: skip
    load = 0.5 + 2.0 * force(np.arange(0.1, 0.4, 1e-4) - late)
    both = join_records(
        camera(), cell(outputs={"Load": load}, sensors={"Load": sensor}), same=EVENTS
    )
    inner = both.time < 0.37
    np.testing.assert_allclose(both.inputs["force"][inner], force(both.time[inner]), atol=3e-3)
    assert both.input_sigma == {"force": pytest.approx(np.hypot(0.05, 0.12 / np.sqrt(12.0)) / 2.0)}
    assert both.input_correlation_time == {"force": 1e-3}
    assert any("gain_sd of Load has no influence" in note for note in both.notes)


def test_a_slower_second_record_is_told():
    both = join_records(camera(), cell(step=1e-2), same=EVENTS)
    assert any("join in the other order" in note for note in both.notes)


def test_what_cannot_be_joined_is_told():
    with pytest.raises(DataError, match=r"expected a time in common"):
        join_records(camera(), cell())
    with pytest.raises(DataError, match="both have y"):
        join_records(camera(), camera())
    whole = cell()
    kept = np.r_[0:1000, 1500 : whole.samples]
    gap = cell(time=whole.time[kept], outputs={"Load": whole.outputs["Load"][kept]})
    with pytest.raises(DataError, match=r"no samples from 1\.4\d+ to 1\.5"):
        join_records(camera(), gap, same=EVENTS)
    for same, why in (
        ([(0.0, 1.0), (0.0, 2.0)], "the same time"),
        ([(0.0, 1.0), (1.0, 3.0)], "2 times as fast"),
        ([(0.0, float("nan"))], "expected a finite number"),
    ):
        with pytest.raises(InvalidParameter, match=why):
            fit_clocks(same)


def test_the_command_writes_a_record_that_is_read_as_it_is(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first, second, out = (tmp_path / n for n in ("a.csv", "b.csv", "both.csv"))
    write_record(camera(), first)
    second.write_text(
        "time [s],Load [N]\n"
        + "".join(f"{t},{f}\n" for t, f in zip(cell().time, cell().outputs["Load"], strict=True))
    )
    same = ",".join(f"{1e3 * a}ms={b}s" for a, b in EVENTS)
    with pytest.raises(SystemExit) as end:
        main(["join", str(first), str(second), "-o", str(out), "--same", same])
    assert end.value.code == 0
    told = capsys.readouterr()
    assert "Load is the input force" in told.err
    assert "of input force, y" in told.out
    both = read_record(out)
    assert both.name == "both"
    np.testing.assert_allclose(both.inputs["force"], force(both.time), atol=1e-5)
    for arguments, why in (
        ((first, second, "-o", first, "--force"), "is the name of a file that is joined"),
        ((first.name, second, "-o", first, "--force"), "is the name of a file that is joined"),
        ((first, second, "-o", tmp_path / "c.csv", "--same", "3s"), "expected TIME=TIME"),
        ((first, second, "-o", tmp_path / "c.csv", "--same", "3s=1m"), "does not measure"),
        ((first, second, "-o", out), "exists"),
    ):
        with pytest.raises(SystemExit) as end:
            main(["join", *map(str, arguments)])
        assert end.value.code != 0
        assert why in capsys.readouterr().err


def test_clocks_are_aligned_by_the_begin_of_the_motion():
    """Both begin at 0.2 s on the clock of the camera; the truth is within the told deviation."""
    from unmodeled.data.joining import align_clocks

    rng = np.random.default_rng(0)

    def ramp(t, noise):
        return np.clip(t - 0.2, 0.0, 0.1) + rng.normal(0.0, noise, t.size)

    t = np.arange(0.0, 0.5, 2e-3)
    late = np.arange(-0.1, 0.6, 5e-4)
    one = camera(outputs={"y": ramp(t, 2e-4)})
    two = cell(time=OFFSET + late, outputs={"Load": ramp(late, 1e-3)})
    clocks, sd = align_clocks(one, two)
    assert clocks.offset == pytest.approx(OFFSET, abs=sd)
    assert clocks.rate == 1.0
    both = join_records(one, two, same=[(0.0, clocks.offset)], same_sd=sd)
    assert both.sensors["y"].delay_sd == sd
    with pytest.raises(DataError, match="does not begin at rest"):
        align_clocks(one, cell(time=OFFSET + late, outputs={"Load": late}))


@pytest.mark.parametrize("fault", [-1.5, 1.5])
def test_the_clocks_of_a_machine_off_its_table_are_as_far_off_as_is_told(fault):
    """A slow cart: a mass off by 1.5 tolerances makes it late by 3 to 4 ms, not by 2 ms."""

    def rates(_, x, u, p):
        return x.v, (u.force - 100.0 * x.y - 20.0 * x.v) / p.mass

    states = {"y": (0.0, 1e-4, "m"), "v": (0.0, 1e-3, "m/s")}

    def cart(mass):
        return unmodeled.Equations(
            rates, states=states, outputs={"y": "y"}, parameters={"mass": (mass, 0.15, "kg")}
        )

    time = np.arange(0.0, 1.0, 2e-3)
    push = 3.0 * np.clip((time - 0.2) / 0.05, 0.0, 1.0)
    known = Record(name="r", time=time, inputs={"force": push}, outputs={"y": 0.0 * time})
    true = cart(1.0 + 0.15 * fault)
    motion = true.simulate(known, prior_jobs(true, known))[0, :, 0]
    one = camera(time=time, outputs={"y": motion + 1e-6 * np.sin(900.0 * time)})
    two = cell(time=time + 0.3, outputs={"Load": push})
    made = join_by_motion(one, two, cart(1.0))
    told, sd = "".join(made.notes), made.sensors["y"].delay_sd
    offset = 1e-3 * float(told.partition("first clock is ")[2].split(" ms")[0])
    assert 2e-3 < abs(offset - 0.3) < 2.0 * sd < 30e-3
    assert "most by mass" in told
