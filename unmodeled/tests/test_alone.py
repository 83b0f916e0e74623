"""unmodeled works without feltmb, without a compiler and without compiled modules."""

import subprocess
import sys
import textwrap

ALONE = """
    import sys

    class Forbidden:
        def find_spec(self, name, path=None, target=None):
            if name.split(".")[0] == "feltmb":
                raise AssertionError(f"imports {name}")

    sys.meta_path.insert(0, Forbidden())
    import importlib
    import importlib.metadata
    import pkgutil

    importlib.metadata.entry_points = lambda **_: ()
    import unmodeled

    for module in pkgutil.walk_packages(unmodeled.__path__, "unmodeled."):
        if not module.name.endswith(("__main__", "_tape")):  # a shared object is no module
            importlib.import_module(module.name)
    for name in unmodeled.__all__:
        assert getattr(unmodeled, name) is not None, name
    from unmodeled.cli import cli

    for command in cli.list_commands(None):
        assert cli.get_command(None, command).params
    assert not [n for n in sys.modules if n.split(".")[0] == "feltmb"]
"""


def test_nothing_of_feltmb_is_imported():
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(ALONE)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
