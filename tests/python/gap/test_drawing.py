"""Pictures of the report: everything is shown, nothing of a record is taken for markup."""

import xml.etree.ElementTree as ET

import pytest

from feltmb.gap.drawing import bars, force_traces, ledger_map, waterfall
from feltmb.gap.findings import ComponentRow, HowFar, LedgerCell, Ranked


def cell(record, channel, start, z):
    return LedgerCell(
        record=record, channel=channel, start=start, end=start + 0.1, samples=10, rms=0.2,
        sigma=0.1, z=z, p=0.5, significant=z > 4.0, lag1=0.0,
    )  # fmt: skip


def parsed(svg):
    assert "http" not in svg  # as a page must have it
    return ET.fromstring(svg.replace("xlink:", ""))


def words(svg):
    return [e.text for e in parsed(svg).iter("text")]


def tips(svg):
    return [e.text for e in parsed(svg).iter("title")]


def test_the_map_has_every_cell_and_the_onset():
    cells = [
        cell("<run> $1$", "x", 0.1 * i, z) for i, z in enumerate((0.0, 5.0, float("nan"), 900.0))
    ] + [cell("two", c, 0.0, -1.0) for c in ("x", "force & torque")]
    svg = ledger_map(cells, {"<run> $1$": 0.13})
    assert svg == ledger_map(cells, {"<run> $1$": 0.13})
    assert ledger_map([], {}) == ""
    assert len(tips(svg)) == len(cells) + 1
    assert tips(svg)[1] == "0.1 to 0.2 s: rms 0.2, noise 0.1, excess 5.0 sd, significant"
    assert "onset 0.13 s" in tips(svg)
    for text in ("<run> $1$", "two", "x", "force & torque"):
        assert text in words(svg)


def test_bars_say_what_is_refused():
    def effect(name, posterior):
        given = {f: 0.0 for f in Ranked.__dataclass_fields__}
        given |= {"effect": name, "posterior": posterior, "unit": "N", "magnitude": 0.43}
        given |= {"sd": 0.01, "named": name == "a", "mechanism": f"why {name}"}
        given["converged"] = name == "a"
        return Ranked(**given)

    svg = bars([effect("a", 0.9), effect("b", 0.05)], [], ["b"])
    assert tips(svg) == ["why a", "why b"]
    assert "90%; 0.43 ± 0.02 N" in words(svg)
    assert "refused; 5%; 0.43 N, not converged" in words(svg)
    assert bars([], [], []) == ""


@pytest.mark.parametrize("top", [0.0, float("nan")])
def test_no_waterfall_without_a_gap(top):
    far = HowFar.__new__(HowFar)
    object.__setattr__(far, "waterfall", (("as tabulated", top), ("noise", 1.0)))
    assert waterfall(far) == ""


def test_forces_over_time():
    series = {"time": [0.0, 0.1, 0.2], "force": [1.0, -1.0, 0.5], "sd": [0.1, 0.1, 0.1]}
    row = ComponentRow(
        component="rail", port="rail", unit="N", statistic=1.0, p=0.1, significant=True,
        explained=0.5, trace={f"run {i}": series for i in range(5)},
    )  # fmt: skip
    told = words(force_traces(row))
    assert [w for w in told if w.startswith("run")] == ["run 0", "run 1", "run 2"]
    assert told.count("force [N]") == 3
