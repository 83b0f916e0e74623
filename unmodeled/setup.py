"""Build of the wheel: the integrator is compiled where there is a compiler, otherwise left out.

With UNMODELED_PURE=1 the wheel has no compiled part and the tag py3-none-any.
"""

import importlib.util
import os
import sysconfig
from pathlib import Path

from setuptools import setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_py import build_py

HERE = Path(__file__).resolve().parent
ODE = HERE / "src" / "unmodeled" / "ode"


def builder():
    """The module that compiles, loaded without the package and what it needs."""
    spec = importlib.util.spec_from_file_location("compile", ODE / "compile.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class BuildWithTape(build_py):
    """Adds the compiled integrator to the package, if it can be compiled."""

    def run(self):
        """Copy the files of the package, and compile."""
        super().run()
        folder = Path(self.build_lib) / "unmodeled" / "ode"
        for former in folder.glob("_tape.*"):
            former.unlink()
        if os.environ.get("UNMODELED_PURE"):
            return
        try:
            builder().build(folder)
        except RuntimeError as fault:
            self.announce(f"unmodeled runs without its extension: {fault}", level=3)


class TaggedWheel(bdist_wheel):
    """A wheel with a shared object is one of this platform, for any Python 3."""

    def get_tag(self):
        """Python, ABI and platform."""
        folder = Path(self.bdist_dir or "") / "unmodeled" / "ode"
        if any(folder.glob("_tape.*")):
            platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
            return "py3", "none", platform
        return super().get_tag()


setup(cmdclass={"build_py": BuildWithTape, "bdist_wheel": TaggedWheel})
