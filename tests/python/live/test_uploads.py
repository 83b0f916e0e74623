"""Uploaded records of the live page."""

import pytest


def test_uploaded_columns_are_read_once(tmp_path):
    pytest.importorskip("starlette", reason="extra live is not installed")
    from unmodeled.page.uploads import Uploads

    uploads = Uploads(tmp_path)
    key = uploads.add("a.csv", b"time [s],q [mm]\n0,0\n1,1\n2,2\n")["file"]
    (path,) = tmp_path.rglob("a.csv")
    path.unlink()
    (columns,) = uploads.kept([key]).values()
    assert list(columns.values) == ["time", "q"]
