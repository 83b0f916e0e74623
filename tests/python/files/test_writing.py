"""Results on disk: full disks, long names, devices, permissions."""

import subprocess
import sys
from pathlib import Path

import pytest
from calls import refused, short_strike, stroke_command

import feltmb
from unmodeled.files import check_folder, check_suffix, check_writable, write_text


def test_full_disk_leaves_a_message(tmp_path):
    # HDF5 failed while it closed the file, and the process died of a segmentation fault (139)
    pytest.importorskip("resource")
    code = (
        "import resource, feltmb\n"
        "run = feltmb.simulate('steinway45', 'forte', 0.05)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000))\n"
        "try:\n"
        f"    run.save({str(tmp_path / 'run.nc')!r})\n"
        "except feltmb.Error as error:\n"
        "    print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "run.nc: cannot be written: " in done.stdout
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["a" * 5000, "a" * 5000 + ".toml"])
def test_names_longer_than_names_of_files(name, tmp_path):
    # OSError: [Errno 36] File name too long
    refused(lambda: feltmb.load_action(name), "mechanism")
    refused(lambda: feltmb.load_stroke(name), "stroke")
    refused(lambda: feltmb.load_run(name), "there is no such file")
    refused(lambda: feltmb.load_targets(name), "target file")
    with pytest.raises(feltmb.Error, match="cannot be written"):
        check_writable(tmp_path / name, force=False)


def test_htm_is_the_suffix_of_a_page_as_html_is():
    check_suffix(Path("page.HTM"), ".pdf", ".html")
    with pytest.raises(feltmb.Error, match=r"cannot write \.htm, expected \.pdf"):
        check_suffix(Path("page.htm"), ".pdf")
    with pytest.raises(feltmb.Error, match="is the name of a file, expected that of a folder"):
        check_folder(Path("page.htm"))


def test_name_as_long_as_a_name_may_be(tmp_path):
    # the name of the temporary file was longer, and refused
    assert write_text(tmp_path / ("a" * 250 + ".txt"), "x").read_text() == "x"


def test_folder_that_is_a_file_is_seen_before_long_work(tmp_path):
    # found after the simulation: "cannot be written: File exists"
    (tmp_path / "file").touch()
    with pytest.raises(feltmb.Error, match="is a file, expected a folder"):
        check_writable(tmp_path / "file" / "run.nc", force=False)


def test_devices_are_not_replaced():
    # --out /dev/null --force put a file in the place of the device
    with pytest.raises(feltmb.FileExists, match="is a device"):
        check_writable(Path("/dev/null"), force=True)


def test_name_of_a_stroke_does_not_leave_the_folder(tmp_path):
    # name = "../../outside" wrote outside of --out
    strike = short_strike(tmp_path / "blow.toml", "../../outside")
    (tmp_path / "a").mkdir()
    assert stroke_command("steinway45", strike, "--out", tmp_path / "a" / "b") == 0
    assert [p.name for p in tmp_path.rglob("*.nc")] == ["_.._outside.nc"]
    assert (tmp_path / "a" / "b" / "_.._outside.nc").is_file()


def test_strokes_whose_numbered_names_meet(tmp_path):
    # a, a, a_1 gave a_1.nc twice; the last was refused after its simulation
    names = ["a", "a", "a_1"]
    strikes = [short_strike(tmp_path / f"{i}.toml", name) for i, name in enumerate(names)]
    assert stroke_command("steinway45", *strikes, "--out", tmp_path / "out") == 0
    assert len(list((tmp_path / "out").glob("*.nc"))) == 3


def test_existing_plots_are_seen_before_the_simulation(tmp_path, capsys):
    # the run was simulated and written, then the plots were refused
    (tmp_path / "run_overview.png").touch()
    strike = short_strike(tmp_path / "blow.toml", "blow")
    assert stroke_command("steinway45", strike, "--out", tmp_path / "run.nc", "--plot") == 2
    assert "run_overview.png: exists already" in capsys.readouterr().err
    assert not (tmp_path / "run.nc").exists()


def test_writing_leaves_the_umask_alone(tmp_path, monkeypatch):
    # the umask was set to 0 and back: another thread could write, or keep it, in between
    monkeypatch.setattr("os.umask", lambda mask: pytest.fail(f"umask set to {mask}"))
    path = write_text(tmp_path / "x.txt", "x")
    (tmp_path / "y.txt").touch()
    assert path.stat().st_mode == (tmp_path / "y.txt").stat().st_mode
