"""The digest of the package, by which stored results know their code."""

import importlib
import sys
from types import SimpleNamespace

from unmodeled.files import package_digest


def test_members_know_the_code():
    assert len(package_digest("feltmb")) == 64


def test_the_digest_of_the_package_is_of_all_of_it(monkeypatch, tmp_path):
    digest = importlib.import_module("unmodeled.files.digest")
    for name in ("run/a.py", "contact/b.py", "mechanism/c.toml", "_core.so", "files/digest.py"):
        (tmp_path / name).parent.mkdir(exist_ok=True, parents=True)
        (tmp_path / name).write_text(name)
    package = SimpleNamespace(__file__=str(tmp_path / "__init__.py"))
    monkeypatch.setitem(sys.modules, "anything", package)

    def now():
        return digest.package_digest.__wrapped__("anything")

    first = now()
    seen = {first}
    for name in ("run/a.py", "contact/b.py", "mechanism/c.toml", "_core.so"):
        (tmp_path / name).write_text("changed")
        seen.add(now())
    (tmp_path / "run" / "a.py").rename(tmp_path / "run" / "z.py")
    seen.add(now())
    assert len(seen) == 6
    (tmp_path / "run" / "__pycache__").mkdir()
    (tmp_path / "run" / "__pycache__" / "a.pyc").write_text("any")
    assert now() in seen
