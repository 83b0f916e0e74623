"""Notes that say the same of several records are told once."""

import numpy as np
import pytest

from feltmb.cli import main
from feltmb.data import Record, Sensor
from feltmb.gap import check_records
from feltmb.gap.by_record import grouped

RECORDS = ["a", "b", "run", "run.1", "n[1/2]", "n[2/2]"]


@pytest.mark.parametrize(
    ("notes", "told"),
    [
        (["a: x is late", "b: x is late"], ["in 2 records (a, b): x is late"]),
        (["a.q: never changes", "b.q: never changes"], ["in 2 records (a, b): q: never changes"]),
        (["a.q: never changes", "b.v: never changes"], None),
        (["a.q: late", "b: q: late"], None),
        (["record a: q of v1", "record b: q of v1"], ["in 2 records (a, b): q of v1"]),
        (
            ["a.q: 40% of 2 values, -1 m", "b.q: 9% of 2 values, 1e-3 m"],
            ["in 2 records (a, b): q: 9 .. 40% of 2 values, -1 .. 1e-3 m"],
        ),
        (["a.q: 40% of key1.x", "b.q: 40% of key2.x"], None),
        (["a: equal to b", "run: equal to a"], None),
        (["a.q: 2 s", "a.q: 3 s", "b.q: 3 s"], None),  # one record says it twice
        (["run.1.q: high", "run.q: high"], ["in 2 records (run.1, run): q: high"]),
        (["q: 2 of all", "q: 3 of all"], None),
        (["a: one", "q: of all", "b: one"], ["in 2 records (a, b): one", "q: of all"]),
        (
            [f"{name}: 3 s" for name in RECORDS],
            ["in all 6 records: 3 s"],
        ),
        (["a: 1.5 s", "a: 1.5 s"], ["a: 1.5 s"]),
        (["n: cut"], None),
        (["record a: late"], None),
    ],
)
def test_equal_notes_are_one(notes, told):
    assert grouped(notes, RECORDS) == (notes if told is None else told)


def test_only_the_first_records_are_named():
    names = [f"r{k}" for k in range(20)]
    (told,) = grouped([f"{n}: late" for n in names[:12]], names)
    assert told == f"in 12 records ({', '.join(names[:8])} and 4 more): late"
    (told,) = grouped(["n: late", "m: late"], ["n[1/2]", "n[2/2]", "m"])
    assert told == "in all 2 records: late"


def clipped(k):
    time = np.arange(200) * 0.01
    noise = 1e-3 * np.random.default_rng(k).standard_normal(200)
    q = np.minimum(np.sin(4.0 * np.pi * time) + noise, 0.7 - 0.03 * k)
    sensors = {"q": Sensor(name="q", unit="m")}
    return Record(name=f"r{k}", time=time, inputs={}, outputs={"q": q}, sensors=sensors)


def test_checks_of_ten_records_tell_a_warning_once(tmp_path, capsys):
    checks = check_records([clipped(k) for k in range(10)])
    saturated = [w for w in checks.warnings if "saturated" in w]
    shares = [int(w.split(": ")[1].partition("%")[0]) for w in saturated]
    assert len(saturated) == 10
    assert f"{min(shares)} .. {max(shares)}% of the values sit at the end" in checks.told[0]
    assert checks.told[0].startswith("in all 10 records: q: ")
    assert len([w for w in checks.told if "saturated" in w]) == 1
    for k in range(10):
        pairs = zip(clipped(k).time, clipped(k).outputs["q"], strict=True)
        rows = [f"{t:.3f},{x:.5f}" for t, x in pairs]
        (tmp_path / f"r{k}.csv").write_text("time [s],q [m]\n" + "\n".join(rows) + "\n")
    with pytest.raises(SystemExit, match="0"):
        main(["gap", "check", *(str(tmp_path / f"r{k}.csv") for k in range(10))])
    text = capsys.readouterr()
    said = (text.out + text.err).replace("\n", " ")
    assert said.count("sensor saturated?") == 1
    assert "in all 10 records: q:" in said
