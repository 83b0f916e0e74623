"""What a fresh pair of eyes broke: refused with one message, nothing written."""

from pathlib import Path

import pytest

from feltmb.cli import main

TEST = Path(__file__).parents[3] / "examples" / "tutorial" / "hammer_felt_test.csv"
ENVELOPE = ("felt", "envelope", "synthetic_hammer", "--thickness", "3mm", "--area")
FIT = ("felt", "fit", "steinway45:06", "--fibers", "synthetic_hammer", "--thickness", "3mm")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((*FIT, "--area", "constant:1e-300"), "expected 1e-10 to 1 "),
        ((*FIT, "--area", "constant:1e20"), "expected 1e-10 to 1 "),
        ((*FIT, "--area", "crossed_cylinders:1e300mm,1e300mm"), "expected 1e-06 to 10"),
        (("felt", "identify", TEST, "--material", "synthetic_hammer", "--thickness", "6mm",
          "--area", "1e300m^2"), "expected 1e-10 to 1 m^2"),
        ((*ENVELOPE[:4], "2.9", "--area", "constant:4cm^2"), "give the unit"),
        ((*ENVELOPE, "constant:4cm^2", "-o", "a.toml", "--plot", "a.txt"), "cannot draw .txt"),
        ((*ENVELOPE, "constant:4cm^2", "-o", "s.toml", "--plot", "s.toml/s.png"),
         "for two results"),
        (("stroke", "steinway45", "piano", "--rtol", "1e-9", "--error", "1e-3"), "not both"),
        (("felt", "audit", "steinway45:06", "--all"), "one of them"),
        (("stroke", "steinway45", "big.csv"), "expected 100000 at most"),
        (("stroke", "folder.toml", "piano"), "is a folder"),
        (("validate", "folder.toml"), "is a folder"),
        (("gap", "check", "folder.csv"), "is a folder"),
    ],
)  # fmt: skip
def test_it_is_refused(words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.toml").mkdir()
    (tmp_path / "folder.csv").mkdir()
    (tmp_path / "big.csv").write_text("time [s],force [N]\n0,0\n0.1,1e12\n")
    with pytest.raises(SystemExit) as stop:
        main([str(w) for w in words])
    assert stop.value.code != 0
    assert said in capsys.readouterr().err.replace("\n", " ")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["big.csv", "folder.csv", "folder.toml"]
