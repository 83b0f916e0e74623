"""What objects show of themselves: a short repr, a table in HTML, a picture, labeled arrays."""

import math
import re
import types

import numpy as np
import pytest

import feltmb
from feltmb.display import html_table
from feltmb.run.arrays import summary_unit, table_to_dataset


@pytest.fixture(scope="module")
def run():
    return feltmb.simulate("steinway45", "forte", duration=0.1)


@pytest.fixture(scope="module")
def swept():
    values = {"surfaces.Gp10.point.y": {"offset": [-1e-4, 1e-4]}, "stroke.scale": [0.9, 1.0, 1.1]}
    return feltmb.sweep("steinway45", "forte", values, options={"duration": 0.1}, progress=False)


def test_a_run_is_a_table_with_units(run):
    frame = run.to_dataframe()
    assert frame.shape == run.values.shape
    assert frame.index.name == "time"
    assert frame.attrs["units"]["hammer_tip.x"] == "m"
    np.testing.assert_array_equal(frame["hammer_tip.x"], run["hammer_tip.x"])


def test_short_words_of_a_run_and_a_mechanism(run):
    action = feltmb.load_action("steinway45")
    for shown in (run, action):
        assert len(repr(shown)) < 120
        assert "\n" not in repr(shown)
    html = run._repr_html_()
    assert f"<td>impact_speed</td><td>{run.summary['impact_speed']:.4g}</td><td>m/s</td>" in html
    assert "<td>06</td>" in action._repr_html_()


def test_the_table_of_a_run_lists_times_in_their_order(run):
    names = re.findall(r"<tr><td>(\w+)</td>", run._repr_html_())
    assert sorted(names) == sorted(run.summary)
    times = [run.summary[n] for n in names if n.endswith("_time")]
    assert times == sorted(times)
    assert all(n.endswith("_time") for n in names[: len(times)])


def test_pictures_of_a_run_and_a_mechanism(run):
    assert len(run.plot().axes) > 1
    assert run.plot("finger_force")._repr_png_().startswith(b"\x89PNG")
    assert run.plot("motion").axes[-1].get_xlabel() == "time [ms]"
    assert feltmb.load_action("steinway45").plot().axes
    with pytest.raises(
        feltmb.InvalidParameter, match="kind = 'save_all', expected one of overview"
    ):
        run.plot("save_all")


def test_units_of_a_summary_are_those_of_its_names():
    assert summary_unit("impact_speed") == "m/s"
    assert summary_unit("max_impact_force") == "N"
    assert summary_unit("let_off_gap") == "m"
    assert summary_unit("impact_duration") == "s"


def test_a_gradient_shows_what_its_parameters_do():
    gradient = feltmb.gradient("steinway45", "forte", ["key.mass", "stroke.scale"], duration=0.095)
    assert len(repr(gradient)) < 120
    assert "<td>stroke.scale</td>" in gradient._repr_html_()
    (axes,) = gradient.plot("impact_speed").axes
    assert next(t.get_text() for t in axes.get_yticklabels()) == "stroke.scale"
    assert axes.get_xlabel() == "change [m/s]"
    with pytest.raises(feltmb.InvalidParameter, match="number = 'speed', expected one of: "):
        gradient.plot("speed")


def test_a_sweep_is_an_array_over_its_values(swept):
    data = swept.to_xarray()
    assert dict(data.sizes) == {"surfaces.Gp10.point.y": 2, "stroke.scale": 3, "stroke": 1}
    assert data["surfaces.Gp10.point.y"].attrs["units"] == "m"
    assert data["impact_speed"].attrs["units"] == "m/s"
    for row in swept.table.to_dict("records"):
        at = {name: row[name] for name in data.sizes}
        assert float(data["impact_speed"].sel(at)) == row["impact_speed"]
    assert "<th>stroke.scale</th>" in swept._repr_html_()


def test_points_that_are_no_grid_have_one_dimension():
    import pandas as pd

    table = pd.DataFrame({"a": [1, 2], "b": ["x", "y"], "force": [3.0, math.nan]})
    data = table_to_dataset(table, ["a", "b"], {"force": "N", "a": "m"})
    assert dict(data.sizes) == {"member": 2}
    assert data["a"].attrs == {"units": "m"}
    assert data["force"].attrs == {"units": "N"}
    full = table_to_dataset(table, ["a"], {})
    assert dict(full.sizes) == {"a": 2}


def test_texts_of_a_table_are_escaped():
    table = html_table("a < b", ("x",), [("<script>",), (1.23456,)])
    assert "&lt;script&gt;" in table
    assert "a &lt; b" in table
    assert "<td>1.235</td>" in table


def test_functions_that_draw_a_run_exist():
    from feltmb.graphics import plot

    for kind in ("overview", "motion", "striker_speed", "contact_forces", "finger_force", "string"):
        assert isinstance(getattr(plot, kind), types.FunctionType)
