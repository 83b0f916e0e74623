"""Tables of programs as records: each works, or one message names the column and the row."""

import numpy as np
import pandas as pd
import pytest

import unmodeled
from unmodeled.data import Record
from unmodeled.errors import Error

TIME = np.linspace(0.0, 1.0, 12)
PULL = np.sin(5.0 * TIME)


def frame(**changed):
    return pd.DataFrame({"time": TIME, "u": PULL, "y": 2.0 * PULL} | changed)


def read(given, **options):
    return Record.from_frame(given, **{"inputs": ["u"], "outputs": ["y"]} | options)


def with_cell(column, cell):
    table = frame().astype(object)
    table.loc[7, column] = cell
    return table


def frames():
    """Tables with the numbers of :func:`frame`."""
    base = frame()
    yield "text", base.astype(str)
    yield "string", base.astype("string")
    yield "objects", base.astype(object)
    yield "real complex", base.astype(complex)
    yield "category", frame(u=pd.Categorical(PULL))
    yield "dictionary", dict(base.items())
    yield "lists", {k: list(v) for k, v in base.items()}
    yield "time as index", base.set_index("time")
    yield "two levels of an index", base.set_index(["time", "u"])
    pairs = pd.MultiIndex.from_tuples([("time", ""), ("u", ""), ("y", "")])
    yield "two levels of headings", base.set_axis(pairs, axis=1)
    for module, make in (
        ("polars", lambda m: m.DataFrame(dict(base.items()))),
        ("pyarrow", lambda m: m.table(dict(base.items()))),
        ("xarray", lambda m: m.Dataset.from_dataframe(base.set_index("time"))),
    ):
        try:
            yield module, make(__import__(module))
        except ImportError:
            continue


@pytest.mark.parametrize("given", [f for _, f in frames()], ids=[k for k, _ in frames()])
def test_a_table_of_any_program_is_a_record(given):
    record = read(given)
    assert record.time == pytest.approx(TIME)
    assert record.inputs["u"] == pytest.approx(PULL)
    assert record.outputs["y"] == pytest.approx(2.0 * PULL)


@pytest.mark.parametrize("cell", ["n/a", "", None, float("nan"), pd.NA])
def test_a_missing_output_is_missing(cell):
    found = read(with_cell("y", cell)).outputs["y"]
    assert list(np.flatnonzero(np.isnan(found))) == [7]
    for column in ("u", "time"):
        with pytest.raises(Error, match=f"row 8: {column} = nan, expected a finite number"):
            read(with_cell(column, cell))


@pytest.mark.parametrize("column", ["time", "u", "y"])
@pytest.mark.parametrize("cell", ["about 3", 1.0 + 2.0j, "0,5"])
def test_a_cell_that_is_no_number_is_told_with_its_place(column, cell):
    with pytest.raises(Error, match=rf"row 8: {column} = '.*', expected a number") as told:
        read(with_cell(column, cell))
    assert str(told.value).count("row 8") == 1


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (frame().iloc[:0], "record: 0 rows, expected at least 2"),
        (frame().set_axis(["time", "u", "u"], axis=1), "column u is there twice"),
        (
            frame(**{"y [m]": PULL, "y [mm]": PULL}).drop(columns="y"),
            r"column y is there twice .*mm",
        ),
        ({"time": TIME, "u": PULL[:-1], "y": PULL}, "numbers of values: time 12, u 11, y 12"),
        (np.zeros((3, 3)), "got ndarray, expected a DataFrame of pandas or polars"),
        (frame()["y"], "got Series, expected a DataFrame"),
    ],
)
def test_what_is_no_table_of_columns_is_told(given, message):
    with pytest.raises(Error, match=message):
        read(given)


def test_a_row_without_a_run_is_told():
    table = frame(run=["a"] * 4 + [None] * 4 + ["b"] * 4)
    with pytest.raises(Error, match="row 5: run is missing"):
        unmodeled.records_from_frame(table, by="run")


def test_records_without_a_name_are_numbered():
    random = np.random.default_rng(0)
    noisy = [frame(y=2.0 * PULL + 0.01 * random.standard_normal(12)) for _ in range(4)]
    model = unmodeled.Simulator(
        lambda _, inputs, p: {"y": p["a"] * inputs["u"]}, parameters={"a": (2.0, 0.1)}
    )
    report = model.diagnose([read(f) for f in noisy], effects=[], hold_out=["record-3"])
    assert set(report.records) == {"record-1", "record-2", "record-3", "record-4"}
    assert any("4 records without a name are record-1 and so on" in n for n in report.notes)
