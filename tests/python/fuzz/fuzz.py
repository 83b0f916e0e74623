"""Inputs that nobody intended: mutations of valid files and command lines, in a process of its own.

    python fuzz.py TARGET[,TARGET...] FIRST COUNT LOG
    python fuzz.py readers FIRST COUNT

The first runs the cases FIRST ... FIRST + COUNT - 1 of each target. A case is known by its target
and number alone. LOG holds the number of the case at work, which names a crash or a hang.
What is wrong is printed as one JSON object a line. A case that takes more than 10 s of processor
time, 120 s of any time, or 1 GB of memory is wrong.

The second runs COUNT cases of each reader, in children of at most 100 cases each, goes on after a
crash, and prints a line for each reader.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import json
import os
import random
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "bench"))

HERE = Path(__file__).resolve()
DATA = HERE.parents[2] / "data"
MEMORY = 1 << 30  # address space of the cases: more is a fault of the case
SLOWEST = 10.0  # s of processor time
LONGEST = 120  # s of any time, on a busy machine
READERS = ("mat4", "mat5", "mat73", "netcdf", "npz", "csv", "toml", "live")

TOKENS = [
    *(b"nan", b"inf", b"-inf", b"1e999", b"-1e308", b"1e-320", b"0", b"-0.0", b"-1", b"true"),
    *(b"99999999999999999999999999", b"0x7fffffffffffffff", b"2147483648", b'""', b"''", b"[]"),
    *(b"{}", b"[", b"]", b"{", b"}", b"=", b",", b".", b'"', b"\n", b"\r\n", b"\0", b"\xff"),
    *(b"\xef\xbb\xbf", b"\xf0\x9f\x8e\xb9", b"#", b"[[a]]", b"a.b.c = 1\n", b" mm", b'"1e9 kg"'),
    *(b"../../../../etc/passwd", b"$(id)", b"`id`", b"%s%n", b"<script>", b"__import__('os')"),
    *(b"1979-05-27T07:32:00Z", b"12:30", b"9" * 400, b"[" * 60, b"a" * 3000),
]
VALUES: list[object] = [
    *(0, -1, 1, 2, 10**6, 10**12, 10**30, 0.0, -0.0, 0.5, -3.7, 1e-300, 1e300, 1e9, 1e-9),
    *(float("nan"), float("inf"), True, False, "", "x", "1 mm", "1e999 m", "-5 kg", "5 V", " "),
    *([], [0.0], [0.0, 0.0], [1.0, 1.0, 1.0], [1e300, 1e300], ["a", "b"], [[1.0, 2.0]], {}),
    *({"value": 1.0}, {"value": [1.0, 2.0], "unit": "mm"}, {"unit": "m"}, {"value": "x"}),
    *("ground", "../..", "\0", "é\u202e", "a" * 5000, "nan", "true"),
]


# ---------------------------------------------------------------- mutations


def mutate_bytes(data: bytes, rng: random.Random) -> bytes:
    """A few small changes of a text or binary file."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
        at = rng.randrange(len(out) + 1)
        far = min(len(out), at + rng.choice((1, 1, 2, 5, 20, 200)))
        kind = rng.randrange(6)
        if kind == 0:
            del out[at:far]
        elif kind == 1:
            out[at:at] = rng.choice(TOKENS)
        elif kind == 2:
            out[at:far] = rng.choice(TOKENS)
        elif kind == 3:
            out[at:at] = out[at:far] * rng.choice((1, 2, 30))
        elif kind == 4 and out:
            at = min(at, len(out) - 1)
            out[at] ^= 1 << rng.randrange(8)
        elif kind == 5 and rng.random() < 0.3:
            del out[at:]
    return bytes(out)


def mutate_words(data: bytes, rng: random.Random) -> bytes:
    """Other whole numbers in the headers of a binary file: types, lengths, offsets."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4))):
        size = rng.choice((1, 2, 4, 4, 8))
        last = max(0, len(out) - size)
        at = rng.randrange(0, 1 + min(last, rng.choice((64, 400, last or 1))), min(size, 4))
        number = rng.choice((0, 1, 2, 7, 8, 100, 255, 70_000, 2**31 - 1, 2**31, 2**63, 2**64 - 1))
        out[at : at + size] = (number % 2 ** (8 * size)).to_bytes(size, "little")
    return bytes(out)


def mutate_numbers(text: str, rng: random.Random) -> str:
    """Other numbers in a text."""
    import re

    found = list(re.finditer(r"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?", text))
    for match in sorted(rng.sample(found, min(len(found), rng.choice((1, 1, 2, 4)))),
                        key=lambda m: -m.start()):  # fmt: skip
        new = rng.choice(
            ["0", "-1", "1e300", "1e-300", "nan", "inf", "1e30", "-1e30", "99999999999", "", "x"]
            + [repr(float(match[0]) * 10 ** rng.uniform(-6, 6))] * 4
            + [repr(-float(match[0]))]
        )
        text = text[: match.start()] + new + text[match.end() :]
    return text


def mutate_tree(node: object, rng: random.Random) -> object:
    """The same tables with one entry changed, gone, moved or new."""
    import copy

    node = copy.deepcopy(node)
    for _ in range(rng.choice((1, 1, 2, 3))):
        here, path = node, []
        while isinstance(here, (dict, list)) and len(here) and (not path or rng.random() < 0.75):
            key = rng.choice(list(here)) if isinstance(here, dict) else rng.randrange(len(here))
            path.append((here, key))
            here = here[key]
        if not path:
            continue
        table, key = path[-1]
        kind = rng.randrange(5)
        if kind == 0:
            table.pop(key)
        elif kind <= 2:
            table[key] = copy.deepcopy(rng.choice(VALUES))
        elif kind == 3 and isinstance(table, dict):
            table[rng.choice(["value", "unit", "x", "name", "law", "é", "a.b", str(key) + "2"])] = (
                table[key] if rng.random() < 0.5 else copy.deepcopy(rng.choice(VALUES))
            )
        else:
            other, other_key = rng.choice(path)
            table[key] = copy.deepcopy(other[other_key])
    return node


# ---------------------------------------------------------------- targets


class Case:
    """One case: what is given, and a folder of its own."""

    def __init__(self, rng: random.Random, folder: Path):
        self.rng = rng
        self.folder = folder
        self.shown = ""


@cache
def corpus(kind: str) -> list[bytes]:
    """Valid files to begin with."""
    import feltmb
    from feltmb import params

    if kind == "mechanism":
        steinway = (params.folder() / "steinway45.toml").read_bytes()
        own = [p.read_bytes() for p in sorted(DATA.glob("*.toml"))]
        template = (params.folder() / "template.toml.txt").read_bytes()
        return [*own * 6, _memory_laws(own[-1]), template, steinway]
    if kind == "stroke":
        rows = "".join(f"{0.001 * i:.4f},{25 * min(i, 40) / 40:.3f}\n" for i in range(80))
        return [
            b"time [s],force [N]\n" + rows.encode(),
            b"# a\ntime [ms],displacement [mm]\n0,0\n10,1\n20,4\n30,9.5\n",
            b"time [s],force [N]\r\n0,0\r\n0.1,3\r\n0.2,3\r\n",
        ]
    if kind == "stroke_toml":
        folder = params.folder() / "strokes"
        return [p.read_bytes() for p in sorted(folder.glob("*.toml"))]
    if kind == "curves":
        return [b"time [ms],hammer_tip.vx [m/s],u [V]\n0,1,2\n1,,3\n2,5,1\n3,4,\n"]
    if kind == "compression":
        rows = [(0.1 + 0.02 * k, 40.0 * k * k) for k in [*range(12), *range(10, -1, -1)]]
        table = "".join(f"{v:.3f},{p:.1f}\n" for v, p in rows)
        thick = "".join(f"{0.5 / v:.4f};{p:.1f};loading\n" for v, p in rows[:12])
        return [
            b"# a felt\nv_f [-],pressure [kPa]\n" + table.encode(),
            b"thickness [mm];force [N];branch\n" + thick.encode(),
            b"prior deviation [%],pressure [Pa]\n0,0\n10,2000\n30,9000\n20,1000\n",
        ]
    if kind == "felt":
        return [p.read_bytes() for p in sorted((params.folder() / "felts").glob("*.toml"))]
    if kind == "actuator":
        return [p.read_bytes() for p in sorted((params.folder() / "actuators").glob("*.toml"))]
    if kind == "regulation":
        return [p.read_bytes() for p in sorted((params.folder() / "regulation").glob("*.toml"))]
    assert kind == "run"
    action = feltmb.load_action(DATA / "pendulum.toml")
    with tempfile.TemporaryDirectory() as folder:
        path = feltmb.simulate(action, "forte", 0.02, output_rate=2000).save(Path(folder) / "a.nc")
        return [path.read_bytes()]


def _memory_laws(text: bytes) -> bytes:
    return text.replace(b'law = "guarded"', b'law = "felt_memory"\nmemory = { kappa = 0.3 }')


def given_file(case: Case, kind: str, suffix: str, tree: bool) -> Path:
    """A mutated file in the folder of the case."""
    rng = case.rng
    data = rng.choice(corpus(kind))
    how = rng.randrange(3) if tree else rng.randrange(2)
    if how == 0:
        data = mutate_bytes(data, rng)
    elif how == 1:
        data = mutate_numbers(data.decode("utf-8"), rng).encode()
    else:
        import tomllib

        import tomlkit

        changed = mutate_tree(tomllib.loads(data.decode()), rng)
        try:
            data = tomlkit.dumps(changed).encode("utf-8", "surrogatepass")
        except Exception:  # tomlkit cannot write it: no file of this case
            data = mutate_bytes(data, rng)
    path = case.folder / f"given{suffix}"
    path.write_bytes(data)
    case.shown = repr(data[:3000])
    return path


def mechanism(case: Case) -> None:
    """A mechanism file: read, at rest, a short stroke."""
    import feltmb

    action = feltmb.load_action(given_file(case, "mechanism", ".toml", tree=True))
    if case.rng.random() < 0.25:
        stroke = feltmb.ramp_stroke(5.0, 0.001, 0.004, duration=0.006)
        run = feltmb.simulate(action, stroke, output_rate=2000, max_wall=2.0)
        check_run(run)


def check_run(run: object) -> None:
    """Done with finite numbers, or stopped with a stated reason."""
    import numpy as np

    if run.status == "done":  # type: ignore[attr-defined]
        assert np.all(np.isfinite(run.values)), "done, with numbers that are not finite"  # type: ignore[attr-defined]
    else:
        assert run.message, f"{run.status} without a reason"  # type: ignore[attr-defined]


def stroke_csv(case: Case) -> None:
    """A table of force or displacement."""
    import feltmb

    feltmb.load_stroke(given_file(case, "stroke", ".csv", tree=False))


def stroke_toml(case: Case) -> None:
    """A stroke file."""
    import feltmb

    feltmb.load_stroke(given_file(case, "stroke_toml", ".toml", tree=True))


def curves(case: Case) -> None:
    """A table of measured curves, and its page."""
    from feltmb.graphics.viewer import page, read_curves

    text = page(read_curves(given_file(case, "curves", ".csv", tree=False)))
    assert text.count("<script") == 2, "a text became markup"


def compression(case: Case) -> None:
    """A compression test of a felt."""
    from feltmb.fiber import read_compression

    path = given_file(case, "compression", ".csv", tree=False)
    read_compression(path, v_f0=0.1, area=1e-4)


def felt(case: Case) -> None:
    """A felt."""
    from feltmb.felt import load_material

    load_material(given_file(case, "felt", ".toml", tree=True))


def actuator(case: Case) -> None:
    """A key actuator: read and checked, not simulated."""
    from feltmb.action.actuator import load_actuator

    load_actuator(given_file(case, "actuator", ".toml", tree=True))


def regulation(case: Case) -> None:
    """Targets of a regulation: read and checked, not run."""
    import feltmb

    feltmb.load_targets(given_file(case, "regulation", ".toml", tree=True))


ODD: list[object] = [
    *(float("nan"), "x", b"\xff", 3, [1, 2], [[0.0, 1.0]], [], None, "{}", "[]", "null"),
    *('{"a": 1}', '{"reached": "x"}', "9" * 5000, '{"toml": "a = 1"}', "[" * 3000),
    *('{"stroke": 3, "string": {"modes": 1e9}}', '{"event": [1], "time": ["x"]}'),
]


def run_file(case: Case) -> None:
    """A saved run: bytes changed, or an entry replaced by another of HDF5's kinds."""
    import h5py
    import numpy as np

    import feltmb
    from feltmb.graphics.viewer import page

    rng = case.rng
    path = case.folder / "given.nc"
    data = corpus("run")[0]
    if rng.random() < 0.5:
        path.write_bytes(mutate_bytes(data, rng))
        case.shown = "bytes"
    else:
        path.write_bytes(data)
        with h5py.File(path, "r+") as file:
            name = rng.choice([*file, *(f"@{k}" for k in file.attrs)])
            odd = rng.choice(ODD)
            case.shown = f"{name} = {odd!r}"
            with contextlib.suppress(TypeError, ValueError, OSError, RuntimeError):
                if name.startswith("@"):
                    del file.attrs[name[1:]]
                    if odd is not None:
                        file.attrs[name[1:]] = odd
                else:
                    if odd is None or rng.random() < 0.7:
                        values = np.asarray(file[name])
                        del file[name]
                        if odd is not None and rng.random() < 0.5:
                            file[name] = odd
                        else:
                            file[name] = rng.choice([values[:-1], values[::-1], values * np.nan,
                                                     values[:0], values.astype("S3")])  # fmt: skip
    run = feltmb.load_run(path)
    page(run)
    run.events, run.data, run.summary  # noqa: B018
    run.save(case.folder / "again.nc")


SECRET = 42.4242  # stands in the files that an attacked run points to


def _attack(path: Path, rng: random.Random) -> str:
    """Make a saved run lead elsewhere, lie about its sizes, or hold what none holds."""
    import struct
    import zlib

    import h5py
    import numpy as np

    folder = path.parent
    how = rng.choice(("link", "soft", "storage", "virtual", "reference", "group", "bomb", "chunk",
                      "filters", "heaps", "attribute", "names", "text"))  # fmt: skip
    with h5py.File(path, "r+") as file:
        name = rng.choice(list(file))
        shape = file[name].shape
        count = int(np.prod(shape))
        np.full(count + 9, SECRET).tofile(folder / "secret.bin")
        with h5py.File(folder / "secret.h5", "w") as other:
            other["x"] = np.full(shape, SECRET)
        if how in ("link", "soft", "storage", "virtual", "reference", "group", "bomb", "chunk",
                   "filters"):  # fmt: skip
            del file[name]
        if how == "link":
            target = rng.choice(
                (str(folder / "secret.h5"), "secret.h5", "/dev/zero", "\0", "x" * 900)
            )
            file[name] = h5py.ExternalLink(target, rng.choice(("/x", "x", "/", "//x")))
        elif how == "soft":
            file["door"] = h5py.ExternalLink(str(folder / "secret.h5"), "/x")
            file[name] = h5py.SoftLink(rng.choice(("/door", "door", f"/{name}", "/", "..")))
        elif how == "storage":
            place = rng.choice((str(folder / "secret.bin"), "secret.bin", "/dev/zero"))
            file.create_dataset(name, shape, "f8", external=[(place, 0, h5py.h5f.UNLIMITED)])
        elif how == "virtual":
            layout = h5py.VirtualLayout(shape, "f8")
            layout[...] = h5py.VirtualSource(str(folder / "secret.h5"), "x", shape)
            file.create_virtual_dataset(name, layout, fillvalue=SECRET)
        elif how == "reference":
            file.create_dataset(name, shape, rng.choice((h5py.ref_dtype, h5py.regionref_dtype)))
        elif how == "group":
            file.create_group(name)
        elif how == "bomb":
            made = file.create_dataset(name, shape, "f8", chunks=shape, compression="gzip")
            size = rng.choice((10**5, 10**7, 10**8))
            packer = zlib.compressobj(9)
            data = b"".join(packer.compress(bytes(10**5)) for _ in range(size // 10**5))
            made.id.write_direct_chunk((0,) * len(shape), data + packer.flush())
        elif how == "chunk":
            chunks = tuple(rng.choice((1, 1000, 10**6, 2**27)) for _ in shape)
            file.create_dataset(name, shape, "f8", chunks=chunks, maxshape=(None,) * len(shape))
        elif how == "filters":
            recipe = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
            recipe.set_chunk(shape)
            for _ in range(rng.choice((1, 2, 9))):
                recipe.set_deflate(9)
            space = h5py.h5s.create_simple(shape)
            kind = h5py.h5t.IEEE_F64LE
            made = h5py.h5d.create(file.id, name.encode(), kind, space, recipe)
            made.write(h5py.h5s.ALL, h5py.h5s.ALL, np.zeros(shape))
        elif how == "attribute":
            key = rng.choice([*file.attrs])
            del file.attrs[key]
            odd: object = rng.choice(
                (file[name].ref, np.zeros((30, 30)), "\x1b[2J" * 9, b"\xff" * 99)
            )
            file.attrs[key] = odd
        elif how == "names":
            for i in range(rng.choice((1, 300))):
                file[f"a{i}" + rng.choice(("\x1b", "\u202e", "/x", " ", "é"))] = np.zeros(shape)
        elif how == "text":
            file.attrs["provenance"] = rng.choice(
                ("[" * 30_000, '{"a":' * 900, "{}" * 9, "1" * 9999)
            )
    if how == "heaps":
        data = bytearray(path.read_bytes())
        for _ in range(rng.choice((1, 100, 3000))):
            at = rng.randrange(0, len(data) - 64, 8)
            size = rng.choice((4096, len(data) - at, 2**63, 0, rng.randrange(len(data))))
            data[at : at + 16] = b"GCOL\x01\x00\x00\x00" + struct.pack("<Q", size)
        path.write_bytes(data)
    return f"{how} {name}"


def attacked_run(case: Case) -> None:
    """A saved run that leads elsewhere or lies: refused, or read without what is elsewhere."""
    import numpy as np

    import feltmb

    path = case.folder / "given.nc"
    path.write_bytes(corpus("run")[0])
    with contextlib.suppress(TypeError, ValueError, OSError, RuntimeError):
        case.shown = _attack(path, case.rng)
    if case.rng.random() < 0.3:
        path.write_bytes(mutate_bytes(path.read_bytes(), case.rng))
    run = feltmb.load_run(path)
    for values in (run.values, run.time, run.eta, run.end_state, run.end_memory):
        assert not np.any(values == SECRET), "numbers of another file"
    words = [*run.names, *run.units, *run.long_names, run.status, run.message, repr(run)]
    assert all(c.isprintable() or c in "\n\t" for w in words for c in w), "a word commands"


HEADINGS = (
    *(" ", "\t", "[", "]", "(", ")", ",", ";", '"', "'", "#", "time", "force", "thickness", "v_f"),
    *("displacement", "key displacement", "pressure", "a", "é", "s", "ms", "N", "mm", "kPa", "%"),
    *("[s]", "[N]", "[mm]", "[kPa]", "[", " [", "] ", ".", "_", "-", "1", "1e9", "\x1b", "\u202e"),
    *("\0", "\ufeff", "time [s]", "force [N]", "\r", "\\", "\x0b", "\u2028", "nan"),
)


def csv_heading(case: Case) -> None:
    """The first line of a table, in all the readers of tables."""
    import feltmb
    from feltmb.fiber import read_compression
    from feltmb.graphics.viewer import read_curves
    from unmodeled.data import read_record

    rng = case.rng
    parts = []
    for _ in range(rng.choice((1, 2, 3, 5, 12))):
        parts.append(rng.choice(HEADINGS) * rng.choice((1, 1, 1, 2, 30, 3000, 30_000)))
    head = "".join(parts)
    if rng.random() < 0.5:
        head = rng.choice(("time [s],", "force [N],", "v_f,pressure [kPa],")) + head
    path = case.folder / "given.csv"
    path.write_text(f"{head}\n0,0.2\n1,0.3\n2,0.4\n", encoding="utf-8")
    case.shown = repr(head[:2000])
    readers: list[Callable[[], object]] = [
        lambda: feltmb.load_stroke(path),
        lambda: read_curves(path),
        lambda: read_compression(path, v_f0=0.1, area=1e-4),
        lambda: read_record(path, outputs=[rng.choice(("q", "force", "a"))]),
    ]
    faults = []
    for read in readers:
        try:
            read()
        except feltmb.Error as error:
            faults.append(error)
    for error in faults:
        raise error  # one of them, to be judged as any other


# ---------------------------------------------------------------- measured records


@cache
def measured() -> dict[str, tuple[bytes, bytes]]:
    """One measured run in every kind of file that is read, each with the TOML beside it."""
    import h5py
    import numpy as np
    import scipy.io
    import tomlkit

    from unmodeled.data import Record, Sensor, StartPrior, write_record

    rng = np.random.default_rng(5)
    time = 1e-3 * np.arange(60)
    force = np.sin(40.0 * time)
    x = 1e-3 * np.cumsum(force)
    y = x + 1e-5 * rng.standard_normal(60)
    y[7] = np.nan
    z = np.round(x, 4)
    sensors = {"y": Sensor(name="y", unit="m"), "z": Sensor(name="z", unit="m", sigma=1e-4)}
    record = Record(
        name="a", time=time, inputs={"force": force}, outputs={"y": y, "z": z}, sensors=sensors,
        input_sigma={"force": 0.01}, start=StartPrior(mean={"x": 0.0}, sd={"x": 1e-3}),
        conditions={"humidity": 0.4, "place": "b"}, repeats="r",
    )  # fmt: skip
    out = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_record(record, folder / "a.csv")
        sheet = (folder / "a.toml").read_bytes()
        out[".csv"] = ((folder / "a.csv").read_bytes(), sheet)
        units = tomlkit.parse(sheet.decode())
        for channel in ("y", "z"):
            units["outputs"][channel]["unit"] = "m"  # type: ignore[index]
        full = tomlkit.dumps(units).encode()
        columns = {"time": time, "force": force, "y": y[:, None], "z": z}
        for packed in (False, True):
            scipy.io.savemat(folder / "a.mat", columns, do_compression=packed)
            out[f".mat {packed}"] = ((folder / "a.mat").read_bytes(), full)
        for suffix in (".nc", ".mat 7.3"):
            with h5py.File(folder / "a.h5", "w") as file:
                for key, values in columns.items():
                    file[key] = values if suffix == ".mat 7.3" else np.ravel(values)
                    if suffix == ".nc":
                        file[key].attrs["units"] = {"time": "s", "force": "N"}.get(key, "m")
                if suffix == ".nc":
                    file["z"].attrs.update(scale_factor=1.0, add_offset=0.0, _FillValue=-9.0)
            out[suffix] = ((folder / "a.h5").read_bytes(), full)
    return out


def change_hdf5(path: Path, rng: random.Random) -> str:
    """Replace an entry or an attribute of an HDF5 file by something else of HDF5's kinds."""
    import h5py
    import numpy as np

    with h5py.File(path, "r+") as file:
        name = rng.choice(list(file))
        odd = rng.choice(ODD)
        attributes = [*file[name].attrs, "units", "scale_factor", "add_offset", "_FillValue"]
        key = rng.choice(attributes) if rng.random() < 0.6 else ""
        with contextlib.suppress(TypeError, ValueError, OSError, RuntimeError):
            if key:
                file[name].attrs[key] = odd
            elif rng.random() < 0.3:
                shape = rng.choice(((10**7,), (10**13,), (3, 0), (0,), (60, 60), (2,) * 12))
                del file[name]
                file.create_dataset(name, shape, "f8", chunks=True)
                odd = shape
            else:
                values = np.asarray(file[name])
                del file[name]
                file[name] = rng.choice([odd, values[:-1], values * np.nan, values.astype("S3"),
                                         values + 1j, values > 0, 1e308 * values])  # fmt: skip
    return f"{name} {key} = {odd!r}"


def record_file(case: Case) -> None:
    """A measured record as CSV, MAT or NetCDF with its TOML: read, checked, written again."""
    import tomllib

    import tomlkit

    from unmodeled.data import read_record, write_record
    from unmodeled.search.records import check_records

    rng = case.rng
    kind = rng.choice(list(measured()))
    data, sheet = measured()[kind]
    path = case.folder / f"given{kind.partition(' ')[0]}"
    case.shown = kind
    how = rng.randrange(4)
    if how == 0:
        sheet = mutate_bytes(sheet, rng) if rng.random() < 0.3 else mutate_numbers(
            sheet.decode(), rng).encode()  # fmt: skip
        case.shown += f" beside {sheet!r}"
    elif how == 1:
        with contextlib.suppress(Exception):  # tomlkit cannot write it: the sheet stays
            sheet = tomlkit.dumps(mutate_tree(tomllib.loads(sheet.decode()), rng)).encode()
        case.shown += f" beside {sheet!r}"
    elif kind == ".csv" and how == 2:
        data = mutate_numbers(data.decode(), rng).encode()
    else:
        data = mutate_bytes(data, rng)
    path.write_bytes(data)
    if kind in (".nc", ".mat 7.3") and how == 2:
        path.write_bytes(measured()[kind][0])
        case.shown += " " + change_hdf5(path, rng)
    elif kind == ".csv":
        case.shown += f" {data[:2000]!r}"
    path.with_suffix(".toml").write_bytes(sheet)
    record = read_record(path)
    check_records([record])
    write_record(record, case.folder / "again.csv")
    read_record(case.folder / "again.csv")


@cache
def reader_seeds() -> dict[str, list[tuple[str, bytes, bytes]]]:
    """Valid measured files by reader: suffix, bytes, and the TOML beside them."""
    import h5py  # noqa: F401  (before the limit on memory)
    import scipy.io

    from unmodeled.data import read_record

    old = measured()
    out = {
        "mat5": [(".mat", *old[".mat False"]), (".mat", *old[".mat True"])],
        "mat73": [(".mat", *old[".mat 7.3"])],
        "netcdf": [(".nc", *old[".nc"])],
        "toml": [(".csv", *old[".csv"])],
    }
    text, sheet = old[".csv"]
    words = text.decode()
    german = words.replace(",", ";").replace(".", ",")
    out["csv"] = [
        (".csv", text, sheet),
        (".csv", german.encode(), sheet),
        (".tsv", words.replace(",", "\t").encode(), sheet),
        (".txt", b"# a comment\n\n" + text.replace(b"\n", b"\r\n"), sheet),
        (".csv", b"\xef\xbb\xbf" + text, sheet),
    ]
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "a.mat"
        path.write_bytes(old[".mat False"][0])
        columns = {k: v for k, v in scipy.io.loadmat(path).items() if not k.startswith("__")}
        scipy.io.savemat(path, columns, format="4")
        out["mat4"] = [(".mat", path.read_bytes(), old[".mat False"][1])]
        for seeds in out.values():
            for suffix, data, sheet in seeds:
                path = Path(name) / f"b{suffix}"
                path.write_bytes(data)
                path.with_suffix(".toml").write_bytes(sheet)
                assert read_record(path).samples == 60
    return out


def read_measured(case: Case, reader: str) -> None:
    """A measured file in one format: read, and checked."""
    from unmodeled.data import read_record
    from unmodeled.search.records import check_records

    rng = case.rng
    suffix, data, sheet = rng.choice(reader_seeds()[reader])
    path = case.folder / f"given{suffix}"
    if reader == "toml":
        sheet = mutate_bytes(sheet, rng)
        case.shown = repr(sheet)
    elif reader in ("mat73", "netcdf") and rng.random() < 0.4:
        path.write_bytes(data)
        case.shown = change_hdf5(path, rng)
        data = path.read_bytes()
    elif reader == "csv":
        if rng.random() < 0.3:
            data = mutate_numbers(data.decode(), rng).encode()
        else:
            data = mutate_bytes(data, rng)
        if rng.random() < 0.1:
            encoding = rng.choice(("utf-16", "latin-1"))
            data = data.decode("utf-8", "replace").encode(encoding, "replace")
        case.shown = repr(data[:2000])
    else:
        data = rng.choice((mutate_bytes, mutate_words, mutate_words))(data, rng)
    path.write_bytes(data)
    path.with_suffix(".toml").write_bytes(sheet)
    check_records([read_record(path)])


@cache
def checkpoint() -> bytes:
    """A saved fiber simulation."""
    from feltmb import fiber

    box, cycle = fiber.FiberBox(n_fibers=40, n_beads=8), fiber.Cycle(0.12, 1e-3, 10, 20, 1)
    with tempfile.TemporaryDirectory() as name:
        run = fiber.simulate(box, cycle, max_samples=2)
        return run.save(Path(name) / "a.npz").read_bytes()


def npz(case: Case) -> None:
    """A saved fiber simulation: bytes, an array or its header changed."""
    import numpy as np

    from feltmb import fiber

    rng = case.rng
    path = case.folder / "given.npz"
    path.write_bytes(checkpoint())
    if rng.random() < 0.4:
        path.write_bytes(rng.choice((mutate_bytes, mutate_words))(checkpoint(), rng))
    else:
        with np.load(path) as file:
            arrays = dict(file)
        name = rng.choice([*arrays, "header", "header"])
        if name == "header" and rng.random() < 0.8:
            tree = mutate_tree(json.loads(str(arrays["header"])), rng)
            arrays["header"] = np.array(json.dumps(tree))
        else:
            old = arrays.pop(name)
            odd = rng.choice((None, 3.0, "x", [], np.zeros((2, 2, 2)), old[..., None],
                              np.full(old.shape, 1e300), np.full(old.shape, np.nan)))  # fmt: skip
            if odd is not None:
                arrays[name] = np.asarray(odd)
        case.shown = name
        np.savez(path, **arrays)
    fiber.FiberRun.load(path)


@cache
def studio() -> object:
    """A live page's mechanism, with one measured file."""
    import logging

    from feltmb.live.app import Studio

    logging.getLogger("feltmb").setLevel(logging.CRITICAL)
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "a.csv"
        path.write_bytes(b"time [s],arm.angle [deg]\n" + b"".join(
            b"%.3f,%.3f\n" % (0.001 * k, 0.01 * k) for k in range(40)))  # fmt: skip
        return Studio(str(DATA / "pendulum.toml"), [path])


def live(case: Case) -> None:
    """A message to a live page: answered, and so is the next one."""
    import asyncio

    from feltmb.live.app import Page

    rng = case.rng
    knobs = [*studio().bench.knobs, *studio().bench.numbers, "x"]  # type: ignore[attr-defined]
    numbers = {rng.choice(list(studio().bench.numbers)): 1.0}  # type: ignore[attr-defined]
    seed = rng.choice([
        {"do": "simulate", "id": 1, "turned": {"knobs": {rng.choice(knobs): 1e-4},
         "numbers": numbers}, "shown": ["arm.angle"],
         "playing": {"kind": "free", "duration": 0.02}},
        {"do": "simulate", "id": 1, "turned": {"numbers": numbers},
         "playing": {"kind": "drawn", "time": [0.0, 0.01], "value": [0.0, 1.0]}},
        {"do": "measure", "id": 1, "turned": {"numbers": numbers}, "files": ["a.csv"],
         "read": {"a.csv": {"columns": {"arm.angle": "arm.angle"}, "units": {}, "scales": {}}}},
        *({"do": word} for word in ("forget", "stop")),
    ])  # fmt: skip
    seed = mutate_tree(seed, rng)
    if isinstance(seed, dict) and rng.random() < 0.5 and isinstance(seed.get("turned"), dict):
        huge = rng.choice((1e18, -1e308, 1e-300, 0.0, -1.0, 1e6, 2**63))
        seed["turned"] = {"numbers": dict.fromkeys(numbers, huge)}
    if isinstance(seed, dict) and seed.get("do") in ("diagnose", "plan", "regulate"):
        return  # long when they are right
    try:
        text = json.dumps(seed)
    except (TypeError, ValueError):
        return
    if rng.random() < 0.2:
        text = mutate_bytes(text.encode(), rng).decode("utf-8", "replace")
    case.shown = text[:2000]

    class Socket:
        """Sends the message and then an unknown one."""

        def __init__(self) -> None:
            self.texts = [text, '{"do": "this is the end"}']
            self.answered = asyncio.Event()

        async def receive_text(self) -> str:
            await asyncio.sleep(0.0 if len(self.texts) == 2 else 0.3)
            if self.texts:
                return self.texts.pop(0)
            await self.answered.wait()
            raise RuntimeError("closed")

        async def send_bytes(self, said: bytes) -> None:
            text = said[4 : 4 + int.from_bytes(said[:4], "little")].decode()
            json.loads(text)
            if "this is the end" in text:
                self.answered.set()

    async def talk() -> bool:
        socket = Socket()
        await asyncio.wait_for(Page(studio(), socket).serve(), 60.0)  # type: ignore[arg-type]
        return socket.answered.is_set()

    assert asyncio.run(talk()), "the page did not answer the next message"


def _reader(name: str) -> Callable[[Case], None]:
    return lambda case: read_measured(case, name)


SAFE = (  # command lines that are quick when they are right
    ["list"],
    ["list", "--json"],
    ["validate", "{pendulum}"],
    ["validate", "{pendulum}", "{csv}", "--json"],
    ["show", "{pendulum}"],
    ["show", "{pendulum}", "--values", "--json"],
    ["show", "{pendulum}", "--plot", "{out}/m.png"],
    ["stroke", "{pendulum}", "{csv}", "--duration", "0.01", "--out", "{out}/a.nc"],
    ["stroke", "{pendulum}", "forte", "--duration", "0.01", "--set", "arm.mass=0.03", "--json"],
    ["stroke", "{pendulum}", "piano", "--duration", "0.01", "--rtol", "1e-5", "--output-rate",
     "2000", "--max-wall", "3", "--no-ledger"],
    ["stroke", "{pendulum}", "piano", "forte", "--duration", "0.005", "--jobs", "2"],
    ["view", "{run}", "--out", "{out}/a.html", "--slowness", "10", "--segment", "0", "0.02"],
    ["view", "{run}", "{run}", "--at", "0.01", "--align", "felt_off", "--out", "{out}/b.html"],
    ["wav", "{run}", "--out", "{out}/a.wav"],
    ["plot", "{run}", "--compare", "arm.angle", "--out", "{out}"],
    ["new", "{out}/new.toml"],
    ["felt"],
    ["--version"],
    ["--help"],
)  # fmt: skip
JUNK = (
    *("", "-", "--", "-1", "0", "nan", "inf", "1e999", "1e15", "-1e15", "99999999999999999999"),
    *(
        "x",
        "é",
        "\u202e",
        "a" * 4000,
        "--nope",
        "--json",
        "--force",
        "-h",
        "--set",
        "a=b",
        "=",
        ".",
    ),
    *("..", "/", "/dev/null", "/dev/full", "/proc/self/mem", "/nonexistent/a.nc", "{out}"),
    *("string.modes=true", "arm.mass=nan", "arm.mass=[", "*.*=1", "contacts.*.law=printed"),
    *("{run}", "{csv}", "{pendulum}", "{out}/a.nc", "steinway", "{{", "%s", "$(id)", "@x", "a,b"),
)


def command_line(case: Case) -> None:
    """A command with words dropped, doubled, swapped or replaced."""
    from feltmb.cli import main

    rng = case.rng
    pendulum = case.folder / "pendulum.toml"
    pendulum.write_bytes((DATA / "pendulum.toml").read_bytes())
    (case.folder / "force.csv").write_bytes(corpus("stroke")[2])
    (case.folder / "run.nc").write_bytes(corpus("run")[0])
    out = case.folder / "out"
    out.mkdir()
    words = list(rng.choice(SAFE))
    for _ in range(rng.choice((0, 1, 1, 1, 2, 3))):
        at = rng.randrange(len(words) + 1)
        kind = rng.randrange(5)
        if kind == 0 and len(words) > 1:
            del words[min(at, len(words) - 1)]
        elif kind == 1:
            words.insert(at, rng.choice(JUNK))
        elif kind == 2 and at < len(words):
            words[at] = rng.choice(JUNK)
        elif kind == 3 and at < len(words):
            words.insert(rng.randrange(len(words)), words[at])
        elif kind == 4 and at < len(words):
            words[at] = mutate_bytes(words[at].encode(), rng).decode("utf-8", "replace")
    names = {"pendulum": pendulum, "csv": case.folder / "force.csv", "run": case.folder / "run.nc"}
    for key, path in (names | {"out": out}).items():
        words = [w.replace(f"{{{key}}}", str(path)) for w in words]
    case.shown = repr(words)[:3000]
    if any(w in ("demo", "regulate", "touch", "all", "fit", "simulate") for w in words):
        return  # long when they are right
    before = {p: p.read_bytes() for p in case.folder.iterdir() if p.is_file()}
    stdout, stderr = io.StringIO(), io.StringIO()
    here = Path.cwd()
    os.chdir(case.folder)
    try:
        with contextlib.redirect_stdout(stdout), contextlib.redirect_stderr(stderr):
            main(words)
        code: object = 0
    except SystemExit as end:
        code = end.code
    finally:
        os.chdir(here)
    said = stderr.getvalue()
    assert code in (0, 1, 2), f"exit code {code!r}"
    assert "Traceback" not in said + stdout.getvalue(), "a traceback"
    assert "not enough memory" not in said, "a size beyond reason was not refused: " + said
    if code != 0:
        assert said.strip(), f"exit code {code} without a word"
        many = said.count("feltmb: ") > 1 and "wrote" not in said and "validate" not in words
        assert not many, "more than one message: " + said
    if "--force" not in words:
        for path, data in before.items():
            assert path.read_bytes() == data, f"{path.name} was changed"


TARGETS: dict[str, Callable[[Case], None]] = {
    f.__name__: f
    for f in (
        *(
            mechanism,
            stroke_csv,
            stroke_toml,
            curves,
            compression,
            felt,
            regulation,
            actuator,
            run_file,
            attacked_run,
            csv_heading,
        ),
        *(record_file, command_line, npz, live),
    )
}
TARGETS |= {name: _reader(name) for name in READERS if name not in TARGETS}


# ---------------------------------------------------------------- running


def run_case(target: str, number: int) -> str | None:
    """What is wrong with a case, or None."""
    import feltmb
    from unmodeled.errors import printable

    with tempfile.TemporaryDirectory(prefix="fuzz") as name:
        case = Case(random.Random(f"{target} {number}"), Path(name))
        begin = time.process_time()
        wrong = None
        ignored: list[str] = []
        sys.unraisablehook = lambda what: ignored.append(repr(what.exc_value))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                TARGETS[target](case)
        except feltmb.Error as error:
            text = str(error)
            if not text.strip():
                wrong = f"{type(error).__name__} without a message"
            elif len(text) > 5000 or max(map(len, text.splitlines())) > 1100:
                wrong = f"a message of {len(text)} letters: {text[:300]}"
            elif printable(text) != text:
                wrong = f"a message that commands a terminal: {text[:600]!r}"
            elif "\0" in text or "Traceback" in text or "object at 0x" in text:
                wrong = f"a message that is none: {text[:600]}"
        except MemoryError:
            wrong = "MemoryError: a size beyond reason was not refused"
        except BaseException:
            wrong = traceback.format_exc(limit=-6)
        spent = time.process_time() - begin
        if wrong is None and ignored:
            wrong = f"said on the way: {ignored[0]}"
        if wrong is None and spent > SLOWEST:
            wrong = f"took {spent:.0f} s"
        left = [str(p.relative_to(name)) for p in Path(name).rglob(".feltmb*")]
        if wrong is None and left:
            wrong = f"left behind: {', '.join(left)}"
        return None if wrong is None else f"{wrong}\n  given: {case.shown}"


def prepare(target: str) -> None:
    """Make the seeds, and import what a case needs, before the memory is limited."""
    import ctypes

    import scipy.io
    import scipy.stats  # noqa: F401

    with contextlib.suppress(AttributeError, OSError):  # arenas of threads take address space
        ctypes.CDLL(None).mallopt(-8, 1)
    if target in READERS[:3] or target in ("netcdf", "csv", "toml"):
        reader_seeds()
    elif target in ("npz", "live"):
        {"npz": checkpoint, "live": studio}[target]()


def readers(first: int, count: int) -> int:
    """Run cases of each reader in children; print the counts, and return that of faults."""
    import subprocess

    total = 0
    with tempfile.TemporaryDirectory() as name:
        log = Path(name) / "case"
        for target in READERS:
            begin, wrong, at = time.monotonic(), 0, first
            while at < first + count:
                most = min(100, first + count - at)
                words = [sys.executable, str(HERE), target, str(at), str(most), str(log)]
                log.write_text(str(at))
                child = subprocess.run(words, capture_output=True, text=True, check=False)
                print(child.stdout, end="", flush=True)
                wrong += child.stdout.count('{"target"')
                at += most
                if child.returncode != 0:
                    print(f"{target} {log.read_text()}: ended by {child.returncode}, "
                          f"{child.stderr[-600:]}", flush=True)  # fmt: skip
                    wrong += 1
                    at = int(log.read_text()) + 1
            seconds = time.monotonic() - begin
            print(f"| {target} | {count} | {wrong} | {seconds:.0f} s |", flush=True)
            total += wrong
    return total


def main(targets: list[str], first: int, count: int, log: Path) -> None:
    """Run the cases and print what is wrong."""
    for target in targets:
        prepare(target)
    space = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (space, space))
    for target, number in itertools.product(targets, range(first, first + count)):
        log.write_text(str(number) if len(targets) == 1 else f"{target} {number}")
        # A hang in a library is ended by the system, on a busy machine too.
        cpu = int(time.process_time() + 2 * SLOWEST)
        resource.setrlimit(resource.RLIMIT_CPU, (cpu, resource.RLIM_INFINITY))
        signal.alarm(LONGEST)
        wrong = run_case(target, number)
        if wrong is not None:
            print(json.dumps({"target": target, "case": number, "wrong": wrong}), flush=True)


if __name__ == "__main__":
    if sys.argv[1] == "readers":
        sys.exit(readers(int(sys.argv[2]), int(sys.argv[3])) != 0)
    main(sys.argv[1].split(","), int(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4]))
