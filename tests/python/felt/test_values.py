"""Values of a felt test that no test has."""

import pytest
from calls import refused

from feltmb.fiber import read_compression


@pytest.mark.parametrize(
    ("heading", "rows", "said"),
    [
        ("v_f [-],pressure [kPa]", {9: "1e300,1440.0"}, "line 11: v_f = 1e+300"),
        ("v_f [-],pressure [kPa]", {3: "0.13,-1e300"}, "line 5: pressure = -1e+303 Pa"),
        ("v_f [-],pressure [MPa]", {3: "0.13,1e305"}, "holds a value beyond 1.8e308 Pa"),
    ],
)
def test_values_that_no_test_has_are_refused(tmp_path, heading, rows, said):
    """Their products were not finite."""
    path = tmp_path / "felt.csv"
    lines = [rows.get(i, f"{0.1 + 0.01 * i:g},{10.0 * i * i:g}") for i in range(12)]
    path.write_text("\n".join([heading, *lines, ""]))
    refused(lambda: read_compression(path, v_f0=0.1, area=1e-4), said)
