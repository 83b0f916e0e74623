"""Members of a sweep that were edited."""

import json
import warnings

import h5py
import pytest

import feltmb


def folder(path):
    path.mkdir()


def sweep_into(folder, pendulum, **more):
    return feltmb.sweep(
        pendulum, "staccato", {"arm.mass": [0.02, 0.03]}, options={"duration": 0.002},
        folder=folder, progress=False, jobs=1, **more,
    )  # fmt: skip


def change_number(path):
    found = json.loads(path.read_text())
    found["numbers"] = {k: v + 1.0 for k, v in found["numbers"].items()}
    path.write_text(json.dumps(found))


def change_run(path):
    with h5py.File(path.with_suffix(".nc"), "a") as file:
        name = next(n for n in file if n.endswith(".angle"))
        file[name][:] = 1.0


def cut(path):
    path.write_text(path.read_text()[:100])


@pytest.mark.parametrize("damage", [change_number, change_run, cut])
def test_a_member_that_was_edited_is_computed_anew(pendulum, tmp_path, damage):
    # a sweep that was resumed believed any number
    first = sweep_into(tmp_path, pendulum, summary_only=False)
    whole = {p.name: p.read_bytes() for p in tmp_path.glob("*.nc")}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = sweep_into(tmp_path, pendulum, summary_only=False)
    assert again.table.equals(first.table)
    damage(sorted(tmp_path.glob("*.json"))[0])
    with pytest.warns(RuntimeWarning, match="computed again"):
        repeated = sweep_into(tmp_path, pendulum, summary_only=False)
    assert repeated.table.equals(first.table)
    assert sorted(whole) == sorted(p.name for p in tmp_path.glob("*.nc"))
