"""What a report shows of itself in a notebook."""

import numpy as np
import pytest

from feltmb.gap import Effect, LinearModel, Options, Parameter, Record, Sensor, diagnose


@pytest.fixture(scope="module")
def report():
    def record(seed, role):
        u = np.linspace(-1.0, 1.0, 100)
        noise = 1e-3 * np.random.default_rng(seed).standard_normal(100)
        y = 0.9 * u + 0.2 * u**3 + noise
        sensors = {"y": Sensor(name="y", unit="m", sigma=1e-3)}
        return Record(
            name=f"r{seed}", time=0.01 * np.arange(100.0), inputs={"u": u}, outputs={"y": y},
            sensors=sensors, role=role,
        )  # fmt: skip

    model = LinearModel(
        name="line",
        output="y",
        columns={"slope": lambda r: r.inputs["u"]},
        parameters=[Parameter(name="slope", value=1.0, sd=0.1)],
    )
    cubic = Effect(
        name="cubic",
        component="lever",
        unit="m",
        scale=0.1,
        mechanism="The lever bends.",
        regressor=lambda r, shape: r.inputs["u"] ** 3,
    )
    records = [record(0, "fit"), record(1, "fit"), record(2, "held_out")]
    return diagnose(model, [cubic], records, options=Options(bootstrap=0, advice=False))


def test_report_in_one_line_and_in_html(report):
    assert report.named == ("cubic",)
    assert repr(report).startswith("Report(NAMED: cubic; closes ")
    assert len(repr(report)) < 120
    html = report._repr_html_()
    assert "<td>cubic</td>" in html
    assert "The model lacks: cubic" in html


def test_picture_shows_three_stages_of_each_channel(report):
    (axes,) = report.plot().axes
    (row,) = [r for r in report.how_far.rows if r.metric == report.how_far.metric]
    widths = [bar.get_width() for bar in axes.patches]
    expected = [x / row.noise for x in (row.tabulated, row.before, row.after)]
    assert widths == pytest.approx(expected)
    assert [t.get_text() for t in axes.get_yticklabels()] == ["y"]
