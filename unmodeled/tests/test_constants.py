"""The constants of the diagnosis are watched; ``tools/constants.py`` lists and proves them."""

import ast
import importlib.util
import sys
from collections import Counter

#: Number of numerics and decisions; a new one needs a reason, an old one goes.
MOST = 151
#: Number of limits of files.
LIMITS = 9


def test_constants_do_not_grow_and_each_has_a_kind(root, monkeypatch):
    spec = importlib.util.spec_from_file_location("constants", root / "tools" / "constants.py")
    monkeypatch.syspath_prepend(root / "tools")  # for mutate
    tool = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "constants", tool)
    spec.loader.exec_module(tool)
    found = [
        c
        for path in tool.sources()
        for c in tool.constants(
            ast.parse(path.read_text("utf-8")), path.relative_to(tool.PACKAGE).as_posix()
        )
    ]
    known = {(c.file.removeprefix("unmodeled/"), c.name) for c in found}
    for table in tool.KINDS.values():
        for file, names in table.items():
            assert {(file, n) for n in names.split()} <= known
    kinds = Counter(c.kind for c in found)
    assert kinds["numeric"] + kinds["decision"] <= MOST
    assert kinds["limit"] <= LIMITS
