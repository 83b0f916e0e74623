"""The C interface as programs call it: the library that is installed, without a compiler."""

import ctypes

import numpy as np
import pytest
from click.testing import CliRunner

import feltmb
from feltmb.cli.felt import command
from feltmb.contact import law
from unmodeled.errors import FileExists, InvalidParameter

CURVES = {"loading": (5520.0, 1580.0, -600.0), "unloading": (190.0, 5040.0, 3040.0)}
LAWS = {
    "felt_memory": {**CURVES, "kappa": 0.3, "rate_amplitude": 0.2, "rate_time": 1e-3},
    "felt_return_point": CURVES,
    "hunt_crossley": {"stiffness": "164000 N/mm^2.5", "exponent": 2.5, "damping": 0.2},
    "micromechanical": {
        "felt": "synthetic_hammer",
        "thickness": 6e-3,
        "area": {"kind": "crossed_cylinders", "radius_a": 9e-3, "radius_b": 0.55e-3},
    },
}


def library(path):
    """The functions of a library with their types, as MATLAB and Julia state them."""
    made = ctypes.CDLL(str(path))
    number, handle = ctypes.c_double, ctypes.c_void_p
    made.feltmb_felt_create.restype = handle
    made.feltmb_felt_create.argtypes = [ctypes.c_char_p, ctypes.c_char_p, ctypes.c_size_t]
    for name in ("step", "peek"):
        function = getattr(made, f"feltmb_felt_{name}")
        function.restype, function.argtypes = number, [handle, number, number]
    made.feltmb_felt_energy.restype, made.feltmb_felt_energy.argtypes = number, [handle]
    made.feltmb_felt_free.argtypes = made.feltmb_felt_reset.argtypes = [handle]
    place = ctypes.POINTER(number)
    made.feltmb_felt_hit.restype = number
    made.feltmb_felt_hit.argtypes = [handle, number, place, place, number]
    return made


@pytest.mark.parametrize("name", LAWS)
def test_the_library_has_the_forces_of_the_law(tmp_path, name):
    felt = law(name, **LAWS[name])
    made = library(feltmb.export_felt_c(felt, tmp_path / "c"))
    assert (tmp_path / "c" / "feltmb_felt.h").read_text().startswith("/* A contact law of feltmb")
    message = ctypes.create_string_buffer(200)
    handle = made.feltmb_felt_create((tmp_path / "c" / "felt.txt").read_bytes(), message, 200)
    assert handle, message.value
    e = np.abs(np.cumsum(2e-5 * np.random.default_rng(2).standard_normal(300)))
    force = [made.feltmb_felt_step(handle, x, 1e-4) for x in e]
    assert force == [felt.step(x, 1e-4) for x in e]
    assert made.feltmb_felt_peek(handle, 1e-4, 1e-4) == felt.peek(1e-4, 1e-4)
    assert made.feltmb_felt_energy(handle) == felt.energy
    made.feltmb_felt_free(handle)


@pytest.mark.parametrize("count", [20, pytest.param(500, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", LAWS)
def test_a_body_in_steps_of_an_engine_never_gains_energy(tmp_path, name, count):
    """2000 strokes in all, of 1 to 300 g and 0.05 to 6 m/s, in steps of 1/240 s."""
    felt, rng = law(name, **LAWS[name]), np.random.default_rng(1)
    made = library(feltmb.export_felt_c(felt, tmp_path / "c"))
    handle = made.feltmb_felt_create((tmp_path / "c" / "felt.txt").read_bytes(), None, 0)

    def rebound(mass, speed, step):
        made.feltmb_felt_reset(handle)
        x, v = ctypes.c_double(-1e-4), ctypes.c_double(speed)
        energy = first = 0.5 * mass * speed**2
        for _ in range(int(0.3 / step)):
            force = made.feltmb_felt_hit(handle, mass, x, v, step)
            now = 0.5 * mass * v.value**2 + made.feltmb_felt_energy(handle)
            assert now <= energy + 1e-12 * first
            assert force >= 0.0
            energy = now
            if x.value < 0.0 and v.value < 0.0:
                break
        return -v.value / speed

    coarse = [
        rebound(*np.exp(rng.uniform(np.log([1e-3, 0.05]), np.log([0.3, 6.0]))), 1 / 240)
        for _ in range(count)
    ]
    assert min(coarse) > 0.3
    assert max(coarse) < 1.0
    # As fine as wanted: Newton and Euler in steps of 1 us.
    felt.reset()
    x, v = -1e-4, 2.0
    while not (x < 0.0 and v < 0.0):
        v -= 1e-6 * felt.step(x, 1e-6) / 0.009
        x += 1e-6 * v
    assert rebound(0.009, 2.0, 1 / 240) == pytest.approx(-v / 2.0, abs=0.01)
    x, v = ctypes.c_double(0.0), ctypes.c_double(np.nan)
    assert np.isnan(made.feltmb_felt_hit(handle, 1.0, x, v, 1 / 240))
    made.feltmb_felt_free(handle)


def test_a_text_that_is_wrong_has_a_message(tmp_path):
    made = library(feltmb.export_felt_c(law("felt_return_point", **CURVES), tmp_path))
    message = ctypes.create_string_buffer(200)
    text = (tmp_path / "felt.txt").read_text()
    version = feltmb.__version__
    for wrong, told in (
        (text.replace(version, "0.0.1", 1), "0.0.1"),
        (text[: len(text) // 2], "text of a contact law"),
        ("law felt_return_point\nloading 1 2 3\n", "unloading a b c is missing"),
    ):
        assert not made.feltmb_felt_create(wrong.encode(), message, 200)
        assert told in message.value.decode()


def test_files_are_kept_and_functions_have_no_text(tmp_path):
    feltmb.export_felt_c(law("felt_return_point", **CURVES), tmp_path)
    with pytest.raises(FileExists, match=r"felt\.txt"):
        feltmb.export_felt_c(law("felt_memory", **CURVES), tmp_path)
    feltmb.export_felt_c(law("felt_memory", **CURVES), tmp_path, force=True)
    assert "felt_memory" in (tmp_path / "felt.txt").read_text()[:60]


def test_the_command_takes_what_the_unit_takes(tmp_path):
    out = tmp_path / "made"
    result = CliRunner().invoke(command, ["c", "steinway45:04", "-o", str(out)])
    assert result.exit_code == 0, result.output
    assert f"cc -I {out}" in " ".join(result.output.split())
    assert len(list(out.iterdir())) == 3
    wrong = CliRunner().invoke(command, ["c", "synthetic_hammer", "-o", str(out), "--force"])
    assert isinstance(wrong.exception, InvalidParameter)
    assert "without a thickness" in str(wrong.exception)
