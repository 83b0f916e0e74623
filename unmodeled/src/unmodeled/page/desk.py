"""Model, records, check and search of a page; its form has the options of the command line."""

from __future__ import annotations

import io
import math
import re
import tempfile
import threading
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from unmodeled import Options, Report, Stop, check, diagnose
from unmodeled.cli.diagnose import floors
from unmodeled.cli.models import StatedOptions, held_out, load_named
from unmodeled.cli.screen import STAGES
from unmodeled.data import ReadOptions, Record
from unmodeled.errors import Error, InvalidParameter
from unmodeled.files import is_file, read_input
from unmodeled.fit.mjcf_parts import MJCF
from unmodeled.loading import LoadedModel
from unmodeled.models.writing import suffixes
from unmodeled.page.guard import MOST_UPLOAD, fault_of
from unmodeled.page.showing import drawn, rows, teller
from unmodeled.page.uploads import MOST_FILES, Uploads, plain_name

#: Number of samples of a curve, of drawn records, of listed channels and parameters.
MOST_SAMPLES, MOST_RECORDS, MOST_LISTED = 800, 8, 300
#: Models that can be dropped: files that describe a model, and no Python.
DROPPED = (".fmu", *MJCF)

Text = Annotated[str, Field(max_length=200)]
Texts = Annotated[list[Text], Field(max_length=60)]


class Column(BaseModel):
    """What the user states about a column: its channel and its unit; "" is as in the file."""

    model_config = ConfigDict(extra="forbid")
    channel: Text = ""
    unit: Text = ""


class Form(BaseModel):
    """The entries of the page, as texts of the options of ``unmodeled diagnose``."""

    model_config = ConfigDict(extra="forbid")
    files: Annotated[list[Text], Field(max_length=MOST_FILES)] = []
    columns: Annotated[dict[Text, Column], Field(max_length=500)] = {}
    parameter: Texts = []
    unknown: Texts = []
    hold_out: Texts = []
    good_enough: Texts = []
    seconds: Annotated[float, Field(gt=0, le=7200)] = 120.0

    def reading(self) -> ReadOptions:
        """How the files are read.

        Raises
        ------
        InvalidParameter
            Two columns are one channel.
        """
        columns: dict[str, str] = {}
        units: dict[str, str] = {}
        for name, given in self.columns.items():
            if given.channel:
                if given.channel in columns:
                    raise InvalidParameter(
                        f"{given.channel}: got the columns {columns[given.channel]} and {name}, "
                        "expected one; choose another channel for one of them"
                    )
                columns[given.channel] = name
            if given.unit.strip():
                units[given.channel or name] = given.unit.strip()
        return ReadOptions(columns=columns, units=units)


def form_of(given: Any) -> Form:
    """The checked form.

    Raises
    ------
    InvalidParameter
        An entry is not as expected.
    """
    try:
        return Form.model_validate(given)
    except ValidationError as error:
        lines = [f"{'.'.join(map(str, e['loc']))[:80]}: {e['msg'][:200]}" for e in error.errors()]
        raise InvalidParameter("\n".join(lines[:8])) from None


class Desk:
    """What one page works on.

    Parameters
    ----------
    model
        Model as on the command line; "": it will be dropped.
    records
        Measured files.
    """

    def __init__(self, model: str, records: tuple[Path, ...] = ()):
        self._folder = tempfile.TemporaryDirectory(prefix="unmodeled-page")
        self.folder = Path(self._folder.name)
        (self.folder / "records").mkdir()
        self.uploads = Uploads(self.folder / "records")
        self.name, self._stop, self._models = model, threading.Event(), 0
        self.search: dict[str, Any] = {"running": False}
        self.result: Path | None = None
        self._begun = threading.Lock()
        try:
            self._model = self._described(load_named(model)) if model else None
            for path in records:
                if is_file(sheet := path.with_suffix(".toml")):
                    self.uploads.add(sheet.name, read_input(sheet, most=MOST_UPLOAD))
                self.uploads.add(path.name, read_input(path, most=MOST_UPLOAD))
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End the search and remove the files."""
        self._stop.set()
        self._folder.cleanup()

    def _described(self, loaded: LoadedModel) -> dict[str, Any]:
        model = loaded.model
        inputs = [*model.inputs, *(n for names in model.input_modes.values() for n in names)]
        known = getattr(getattr(model, "function", None), "units", {})
        joints = model.joints if not model.outputs else ()  # of a robot; records show which
        inputs += [n.removesuffix(".gear") for n in known if joints and n.endswith(".gear")]
        outputs = [*model.outputs, *(f"{j.name}{end}" for j in joints for end in ("", ".velocity"))]
        return {
            "name": model.name,
            "inputs": inputs[:MOST_LISTED],
            "outputs": outputs[:MOST_LISTED],
            "known": [*known.items()][:MOST_LISTED],
            "parameters": [
                [p.name, p.value, p.sd if math.isfinite(p.sd) else None, p.unit]
                for p in model.parameters[:MOST_LISTED]
            ],
            "states": Path(self.name).suffix.lower() in DROPPED or ".py" in self.name,
        }

    def state(self) -> dict[str, Any]:
        """What the page shows after it was loaded, and while a search runs."""
        return {
            "model": self._model,
            "files": self.uploads.listing(),
            "search": self.search,
            "result": sorted(p.name for p in self.result.iterdir()) if self.result else [],
        }

    def add_model(self, name: str, data: bytes) -> None:
        """Use a model that was dropped.

        Raises
        ------
        InvalidParameter, ModelError
            It is neither an FMU nor a MuJoCo file, or it has faults.
        """
        plain = plain_name(name)
        if Path(plain).suffix.lower() not in DROPPED:
            raise InvalidParameter(
                f"{plain}: got no FMU and no MuJoCo model, expected .fmu or {', '.join(MJCF)}; "
                "equations and functions are given when the page starts: unmodeled page model.py"
            )
        self._models += 1
        folder = self.folder / f"m{self._models}"
        folder.mkdir()
        (folder / plain).write_bytes(data)
        before, self.name = self.name, str(folder / plain)
        try:
            self._model = self._described(load_named(self.name))
        except Exception as error:
            self.name = before
            raise InvalidParameter(self.told(error)) from error

    def told(self, error: Exception) -> str:
        """Message of an error in the words of the page."""
        return self._plain(fault_of(error, "unmodeled page"))

    def _plain(self, text: str) -> str:
        """A message without folders of the server and without options of the command line."""
        text = self.uploads.named(text)
        for k in range(self._models + 1):
            text = text.replace(f"{self.folder / f'm{k}'}/", "")
        return re.sub(r" \((specify it: )?--[^)]*\)", "; say it in the table of columns", text)

    def _loaded(self, form: Form) -> tuple[LoadedModel, list[Path], tuple[tuple[Record, ...], ...]]:
        if not self.name:
            raise InvalidParameter("drop a model first: an FMU, or a MuJoCo model (.xml)")
        kept = self.uploads.kept(form.files)
        stated = StatedOptions(tuple(form.parameter), tuple(form.unknown), "", 0.0, None)
        loaded = load_named(self.name, stated=stated)
        from unmodeled.data.files import read_each

        return loaded, list(kept), read_each(list(kept), loaded.signals, form.reading(), kept)

    def check(self, form: Form) -> dict[str, Any]:
        """Records beside the model as it is, differences, hints and notes."""
        loaded, _, groups = self._loaded(form)
        found = check(loaded.model, [r for group in groups for r in group])
        records = [
            {
                "name": r.name,
                "time": r.time.tolist(),
                "channels": [
                    {"name": c.name, "unit": c.unit, "measured": _listed(c.both[:, 0]),
                     "model": _listed(c.both[:, 1])}
                    for c in r.channels
                ],
            }
            for r in drawn(found, MOST_SAMPLES, MOST_RECORDS)
        ]  # fmt: skip
        return {
            "records": records,
            "rows": rows(found),
            "hints": [self._plain(h.text) for h in found.hints],
            "notes": list(dict.fromkeys(self._plain(n) for n in found.notes)),
        }

    def begin(self, form: Form) -> None:
        """Start the search in a thread.

        Raises
        ------
        InvalidParameter
            An entry is wrong, or a search runs.
        """
        loaded, paths, groups = self._loaded(form)
        files = dict(zip(form.files, paths, strict=True))
        held = held_out(tuple(str(files[k]) for k in form.hold_out if k in files), paths, groups)
        options = Options(
            seconds=form.seconds,
            good_enough=floors(form.good_enough, loaded.model.units),
        )
        with self._begun:
            if self.search["running"]:
                raise InvalidParameter("a search is under way; stop it first")
            self._stop.clear()
            self.search = {"running": True, "stage": STAGES["prepare"], "share": 0.0, "left": None}
        records = [r for group in groups for r in group]

        def work() -> None:
            fault = ""
            try:
                report = diagnose(
                    loaded.model,
                    None if loaded.default else loaded.with_records(records).effects,
                    records,
                    hold_out=held or None,
                    options=options,
                    progress=teller(self._tell, self._stop.is_set),
                )
                self._store(report)
            except Stop:
                fault = "stopped before the model was fitted to the records; there is no answer"
            except Exception as error:  # otherwise the page would wait forever
                fault = self.told(error)
            self.search = {"running": False, "fault": fault, "stopped": self._stop.is_set()}

        threading.Thread(target=work, name="search", daemon=True).start()

    def stop(self) -> None:
        """End the search: its answer is that of the fits so far."""
        self._stop.set()

    def _tell(self, state: Mapping[str, Any]) -> None:
        self.search = {"running": True, **state, "stage": STAGES.get(state["stage"], "")}

    def _store(self, report: Report) -> None:
        """Write report, case and remedy to a new folder."""
        assert report.case is not None
        folder = Path(tempfile.mkdtemp(prefix="result", dir=self.folder))
        report.write(folder, title=f"{report.case.model.name}: diagnosis")
        if report.model is not None:
            try:
                report.model.write(folder / f"remedy{suffixes(report.case.model)[0]}")
            except Error as error:  # beside a report it may be impossible
                (folder / "no_remedy.txt").write_text(f"{error}\n", "utf-8")
        self.result = folder

    def file(self, name: str) -> bytes:
        """A file of the result; case.zip: all of them.

        Raises
        ------
        InvalidParameter
            There is no such file.
        """
        known = {p.name: p for p in self.result.iterdir()} if self.result else {}
        if name != "case.zip" or not known:
            if name not in known or not known[name].is_file():
                raise InvalidParameter(f"{name}: there is no such file; search first")
            return known[name].read_bytes()
        assert self.result is not None
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as file:
            for path in sorted(self.result.rglob("*")):
                file.write(path, Path("case") / path.relative_to(self.result))
        return buffer.getvalue()


def _listed(values: Any) -> list[float | None]:
    """Numbers for JSON."""
    return [float(f"{v:.5g}") if math.isfinite(v) else None for v in values.tolist()]
