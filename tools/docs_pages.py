"""Runs the commands and examples of a page of the documentation, in a folder of its own.

    python tools/docs_pages.py PAGE.md            compares what the page shows
    python tools/docs_pages.py PAGE.md --write    writes what comes into the page

What a page may hold:

- ```console: lines with "$ " are commands, the lines below them what they print. A line "..."
  stands for any lines. Numbers may differ by the tolerance, all other text may not.
- ```python: runs; all blocks of a page share their names. What it prints is not compared, unless
  the next block is <!-- printed -->.
- <!-- file NAME --> before a block: its text becomes the file NAME.
- <!-- start PATTERN ... -->: files of the repository to begin with.
- <!-- picture FILE --> before ![...](img/...): FILE that the commands drew is that picture.
- <!-- screenshot FILE.html -->: the same of a page, for which --write needs Chromium.
- <!-- tolerance 0.05 -->: relative, of the next block.
- <!-- not run: why --> before a block.
- <!-- slow -->: the rest of the page takes long.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import itertools
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
TOLERANCE = 2e-3
BROWSERS = ("chromium-headless-shell", "chromium", "google-chrome")

LOOSE = {"right-hand sides": float("inf"), "energy balance error": 3.0}
"""Relative tolerance of lines with these words: work, wall time, error of the integration."""

NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
DIRECTIVE = re.compile(
    r"<!-- (file|start|picture|screenshot|tolerance|not run|slow|printed)\b:? ?(.*?) ?-->"
)


@dataclass
class Block:
    """A fenced block or a directive of a page."""

    kind: str
    """Language of the block, or name of the directive."""
    text: list[str]
    line: int
    """Index of the block's first line of text, from 0."""
    notes: dict[str, str] = field(default_factory=dict)
    """Directives directly before the block."""


class Mismatch(AssertionError):
    """The page does not show the actual output."""


def blocks(page: Path) -> Iterator[Block]:
    """Blocks of a page in order."""
    lines = page.read_text(encoding="utf-8").splitlines()
    notes: dict[str, str] = {}
    i = 0
    while i < len(lines):
        line = lines[i]
        if found := DIRECTIVE.fullmatch(line.strip()):
            name, value = found.groups()
            if name in ("slow", "start"):
                yield Block(name, value.split(), i)
            elif name in ("picture", "screenshot"):
                shown = re.match(r"!\[.*?\]\((.*?)\)", lines[i + 1])
                if shown is None:
                    raise Mismatch(f"{page.name}:{i + 1}: no picture below")
                yield Block(name, [value, shown.group(1)], i)
            else:
                notes[name] = value
        elif line.startswith("```"):
            end = next(k for k in range(i + 1, len(lines)) if lines[k].startswith("```"))
            yield Block(line[3:].strip(), lines[i + 1 : end], i + 1, notes)
            notes, i = {}, end
        elif line.strip():
            notes = {}
        i += 1


def commands(block: Block) -> list[tuple[str, list[str], int]]:
    """Commands of a console block: the command, its expected output, its line."""
    found: list[tuple[str, list[str], int]] = []
    for number, line in enumerate(block.text):
        if line.startswith("$ "):
            found.append((line[2:], [], block.line + number))
        elif found and found[-1][0].endswith("\\"):
            found[-1] = (found[-1][0][:-1] + line.strip(), [], found[-1][2])
        elif found:
            found[-1][1].append(line)
    return found


def same(expected: str, got: str, tolerance: float) -> bool:
    """Whether two lines agree: equal text except for spaces, numbers within the tolerance."""
    texts = [re.sub(r"[\s─]+", " ", " ".join(NUMBER.split(t))).strip() for t in (expected, got)]
    numbers = [NUMBER.findall(t) for t in (expected, got)]
    if texts[0] != texts[1] or len(numbers[0]) != len(numbers[1]):
        return False
    tolerance = max([tolerance, *(t for words, t in LOOSE.items() if words in expected)])
    for a, b in zip(*numbers, strict=True):
        if a == b:
            continue
        x, y = float(a), float(b)
        digits = len(a.partition(".")[2].lower().partition("e")[0])
        last = 0.0 if "e" in a.lower() else 1.01 * 10.0**-digits if "." in a else 0.0
        if not abs(x - y) <= max(tolerance * max(abs(x), abs(y)), last):
            return False
    return True


def compare(expected: list[str], got: list[str], tolerance: float) -> str:
    """Difference of two outputs as text; empty if there is none."""
    want = [line.rstrip() for line in expected if line.strip()]
    have = [line.rstrip() for line in got if line.strip()]
    at = 0
    loose = False
    for line in want:
        if line.strip() == "...":
            loose = True
            continue
        while loose and at < len(have) and not same(line, have[at], tolerance):
            at += 1
        if at >= len(have) or not same(line, have[at], tolerance):
            shown = have[at] if at < len(have) else "(nothing more)"
            return f"the page shows\n  {line}\nbut what comes is\n  {shown}"
        at += 1
        loose = False
    if at < len(have) and not loose:
        return f"the page does not show\n  {have[at]}"
    return ""


def call(command: str) -> list[str]:
    """Output of a command on both streams; our commands and scripts run in this process."""
    words = shlex.split(command, comments=True)
    said = io.StringIO()
    if words[0] in ("feltmb", "unmodeled") and not {"|", ">", "&&", ";"} & set(words):
        main = importlib.import_module(f"{words[0]}.cli").main
        spread = [p for w in words[1:] for p in (_files(w) if "*" in w else [w])]
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            try:
                main(spread)
            except SystemExit as end:
                if end.code:
                    said.write(f"(exit code {end.code})\n")
        return said.getvalue().splitlines()
    if words[0] == "python" and len(words) > 1 and words[1].endswith(".py"):
        given, path = sys.argv, list(sys.path)
        sys.argv = words[1:]
        sys.path.insert(0, str(Path(words[1]).resolve().parent))
        try:
            with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
                runpy.run_path(words[1], run_name="__main__")
        except Exception:
            said.write(traceback.format_exc())
        finally:
            sys.argv, sys.path[:] = given, path
        return said.getvalue().splitlines()
    done = subprocess.run(
        command, shell=True, capture_output=True, text=True, check=False, timeout=600
    )
    return (done.stdout + done.stderr).splitlines()


def _files(pattern: str) -> list[str]:
    found = sorted(str(p) for p in Path().glob(pattern)) if not pattern.startswith("/") else []
    return found or [pattern]


def elided(expected: list[str], got: list[str], place: str) -> list[str]:
    """Text to be written: the actual output, shortened where the page is shortened.

    Raises
    ------
    Mismatch
        A part of the page between two lines "..." does not come any more.
    """
    have = [line.rstrip() for line in got]
    while have and not have[-1]:
        have.pop()
    marks = [i for i, line in enumerate(expected) if line.strip() == "..."]
    if not marks:
        return have
    at = marks[0]
    written = have[:at]
    for mark, end in itertools.pairwise([*marks, len(expected)]):
        written.append(expected[mark])
        part, last = expected[mark + 1 : end], end == len(expected)
        if not part:
            continue
        start = _start(part[0], have, at)
        if start is None and not last:
            raise Mismatch(
                f'{place}: no line like "{part[0].strip()}", which stands between two "...", comes '
                "any more: write this block by hand"
            )
        if start is None:
            start = max(at, len(have) - len(part))
        # The last part goes to the end of the output, however many lines it has now.
        at = len(have) if last else start + len(part)
        written += have[start:at]
    return written


def _start(line: str, have: list[str], at: int) -> int | None:
    """The first line from ``at`` with the same text except for numbers, or the same first word."""
    texts = [NUMBER.sub("", t).split() for t in (line, *have[at:])]
    for words in (None, 1):
        for i, text in enumerate(texts[1:], at):
            if text[:words] == texts[0][:words]:
                return i
    return None


def run_page(page: Path, folder: Path, *, slow: bool = True, write: bool = False) -> int:
    """Run a page in ``folder``; return the number of commands and examples.

    Raises
    ------
    Mismatch
        The output of a command differs from the page, or an example fails.
    """
    scope: dict[str, Any] = {"__name__": "__main__"}
    printed: list[str] = []
    changes: list[tuple[int, int, list[str]]] = []
    ran = 0
    before = {name: os.environ.get(name) for name in ("COLUMNS", "PATH", "FELTMB_ROOT")}
    path = list(sys.path)
    sys.path_importer_cache.pop(".", None)  # still refers to the folder of the previous page
    os.environ["COLUMNS"] = "80"
    os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    os.environ["FELTMB_ROOT"] = str(ROOT)
    try:
        with contextlib.chdir(folder):
            for block in blocks(page):
                where = f"{page.name}:{block.line + 1}"
                tolerance = float(block.notes.get("tolerance", TOLERANCE))
                if block.kind == "slow":
                    if not slow:
                        break
                elif block.kind == "start":
                    _copy(block.text)
                elif block.kind in ("picture", "screenshot"):
                    _picture(page, block, write=write)
                elif "not run" in block.notes:
                    continue
                elif "file" in block.notes:
                    target = Path(block.notes["file"])
                    target.parent.mkdir(parents=True, exist_ok=True)
                    target.write_text("\n".join(block.text) + "\n", encoding="utf-8")
                elif block.kind == "console":
                    for command, shown, line in commands(block):
                        got = call(command)
                        ran += 1
                        if write:
                            last = block.line + len(block.text)
                            following = [n for _, _, n in commands(block) if n > line]
                            end = min([*following, last])
                            first = end - len(shown)
                            place = f"{page.name}:{line + 1}: $ {command}"
                            changes.append((first, end, elided(shown, got, place)))
                        elif fault := compare(shown, got, tolerance):
                            raise Mismatch(f"{page.name}:{line + 1}: $ {command}\n{fault}")
                elif block.kind == "python":
                    said = io.StringIO()
                    try:
                        with contextlib.redirect_stdout(said):
                            code = "\n" * block.line + "\n".join(block.text)
                            exec(compile(code, str(page), "exec"), scope)
                    except Exception as error:
                        raise Mismatch(f"{where}: {type(error).__name__}: {error}") from error
                    printed = said.getvalue().splitlines()
                    ran += 1
                elif "printed" in block.notes:
                    if write:
                        end = block.line + len(block.text)
                        changes.append((block.line, end, elided(block.text, printed, where)))
                    elif fault := compare(block.text, printed, tolerance):
                        raise Mismatch(f"{where}: {fault}")
    finally:
        sys.path[:] = path
        for name, module in list(sys.modules.items()):  # of this page, not of the next one
            if (getattr(module, "__file__", None) or "").startswith(f"{folder.resolve()}{os.sep}"):
                del sys.modules[name]
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
    if changes:
        lines = page.read_text(encoding="utf-8").splitlines()
        for first, end, text in reversed(changes):
            lines[first:end] = text
        page.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return ran


def _copy(patterns: list[str]) -> None:
    for pattern in patterns:
        pattern, _, target = pattern.partition("=")
        found = sorted(ROOT.glob(pattern))
        if not found:
            raise Mismatch(f"start {pattern}: the repository has no such file")
        Path(target or ".").mkdir(parents=True, exist_ok=True)
        for file in found:
            shutil.copy(file, Path(target or ".") / file.name)


def _picture(page: Path, block: Block, *, write: bool) -> None:
    made, shown = Path(block.text[0]), page.parent / block.text[1]
    if not made.is_file():
        raise Mismatch(f"{page.name}:{block.line + 1}: {made} was not drawn")
    if write:
        shown.parent.mkdir(parents=True, exist_ok=True)
        if block.kind == "screenshot":
            made = screenshot(made)
        small_png(made, shown)
    elif not shown.is_file():
        raise Mismatch(f"{page.name}:{block.line + 1}: {shown.name} is missing; run with --write")


def screenshot(page: Path, size: str = "1000,900") -> Path:
    """Screenshot of an HTML page by Chromium; width and height in pixels."""
    picture = page.with_suffix(".screen.png").resolve()
    program = next((n for n in BROWSERS if shutil.which(n)), None)
    if program is None:
        raise Mismatch(
            f"{page.name}: its picture needs Chromium; on Debian: apt-get install chromium"
        )
    command = [program, "--headless", "--no-sandbox", "--hide-scrollbars", "--disable-gpu"]
    command += [f"--window-size={size}", f"--screenshot={picture}", page.resolve().as_uri()]
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    return picture


def small_png(source: Path, target: Path, width: int = 1100, colors: int = 64) -> None:
    """Copy a picture with few colors and at most the width of a page, to keep it small."""
    from PIL import Image

    with Image.open(source) as image:
        picture = image.convert("RGB")
        if picture.width > width:
            height = round(picture.height * width / picture.width)
            picture = picture.resize((width, height), Image.Resampling.LANCZOS)
        picture.quantize(colors, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(
            target, optimize=True
        )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pages", nargs="+", type=Path)
    parser.add_argument("--write", action="store_true", help="write what comes into the pages")
    parser.add_argument("--fast", action="store_true", help="leave out what takes long")
    options = parser.parse_args()
    for page in options.pages:
        with tempfile.TemporaryDirectory() as folder:
            try:
                ran = run_page(
                    page.resolve(), Path(folder), slow=not options.fast, write=options.write
                )
            except Mismatch as fault:
                print(fault)
                return 1
        print(f"{page}: {ran} commands and examples ran")
    return 0


if __name__ == "__main__":
    sys.exit(main())
