"""Options have the same name in Python and on the command line."""

import dataclasses
import inspect

import unmodeled
from unmodeled.blind import withhold
from unmodeled.cli import COMMANDS
from unmodeled.data import ReadOptions, join_records
from unmodeled.experiment import plan
from unmodeled.lazy import lazy_import
from unmodeled.loading import LoadedModel, load_model
from unmodeled.page.serve import serve

#: Names that only the shell has: files that are written or read, and how they are found.
SHELL = {"out", "force", "json", "config", "set", "data", "report", "measured", "include", "model"}
FUNCTIONS = (unmodeled.diagnose, unmodeled.check, unmodeled.Simulator, withhold, join_records, plan,
             unmodeled.mujoco, load_model, LoadedModel.read_proposed, serve)  # fmt: skip


def test_options_have_the_names_of_arguments():
    """A repeated option has the singular of its mapping or sequence: ``--unit`` is ``units``.

    A switch that turns something off begins with ``no``.
    """
    known = {f.name for kind in (unmodeled.Options, ReadOptions) for f in dataclasses.fields(kind)}
    known |= {name for f in FUNCTIONS for name in inspect.signature(f).parameters}
    known |= {name.removesuffix("s") for name in known} | {f"no_{name}" for name in known}
    options = {
        (command, option.opts[0].removeprefix("--").replace("-", "_"))
        for command, (place, _) in COMMANDS.items()
        for option in lazy_import(place).params
        if option.param_type_name == "option"
    }
    assert len(options) > 80
    assert not sorted(o for o in options if o[1] not in known | SHELL)
