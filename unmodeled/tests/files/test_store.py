"""Finished work in a folder: whole or not there, and never another's."""

import numpy as np
import pytest

from unmodeled.errors import Error
from unmodeled.files import Store, digest_of

DATA = {"number": 0.1, "text": "felt", "list": [1, 2], "none": None}


def test_what_was_put_comes_back(tmp_path):
    store = Store(tmp_path / "a" / "b")
    assert store.get("key") is None
    assert not (tmp_path / "a").exists()  # nothing is made by looking
    store.put("key", DATA)
    assert Store(tmp_path / "a" / "b").get("key") == DATA
    assert store.get("another") is None


def test_every_damaged_byte_is_told(tmp_path):
    Store(tmp_path).put("key", DATA)
    path = tmp_path / "key.json"
    whole = path.read_bytes()
    for place in range(0, len(whole), 7):
        changed = bytearray(whole)
        changed[place] ^= 0x15
        path.write_bytes(changed)
        with pytest.warns(RuntimeWarning, match="computed again"):
            assert Store(tmp_path).get("key") is None
    path.write_bytes(whole)
    assert Store(tmp_path).get("key") == DATA


def test_a_result_is_not_that_of_another_key(tmp_path):
    Store(tmp_path).put("key", DATA)
    (tmp_path / "other.json").write_bytes((tmp_path / "key.json").read_bytes())
    with pytest.warns(RuntimeWarning, match="another key"):
        assert Store(tmp_path).get("other") is None


def test_files_that_belong_to_a_result(tmp_path):
    run = tmp_path / "run.nc"
    run.write_text("motion")
    Store(tmp_path).put("key", DATA, files={"run": run})
    assert Store(tmp_path).get("key", {"run": run}) == DATA
    run.write_text("other motion")
    with pytest.warns(RuntimeWarning, match="belongs to it"):
        assert Store(tmp_path).get("key", {"run": run}) is None
    run.unlink()  # asked for again, no damage
    assert Store(tmp_path).get("key", {"run": run}) is None


def test_a_result_that_cannot_be_written_leaves_the_old_one(tmp_path, monkeypatch):
    Store(tmp_path).put("key", DATA)
    monkeypatch.setattr("pathlib.Path.replace", lambda *_: (_ for _ in ()).throw(OSError("full")))
    with pytest.raises(Error, match="cannot be written"):
        Store(tmp_path).put("key", {"number": 2})
    assert Store(tmp_path).get("key") == DATA
    assert [p.name for p in tmp_path.iterdir()] == ["key.json"]


def test_digests_tell_values_and_order_apart():
    parts = [
        ("ab",), ("a", "b"), (["a", "b"],), ({"a": "b"},), (1,), (1.0,), ("1",), (b"1",),
        (np.array([1.0, 2.0]),), (np.array([[1.0, 2.0]]),), (np.array([1, 2]),), ([1.0, 2.0],),
        (None,), ([],), ({},), ([[], []],), ([[[]]],),
    ]  # fmt: skip
    assert len({digest_of(*p) for p in parts}) == len(parts)
    assert digest_of({"a": 1, "b": 2}) == digest_of({"b": 2, "a": 1})
