"""Runs examples/gallery, draws docs/img/gallery and writes docs/tutorials/gallery.md.

    python tools/make_gallery.py            all
    python tools/make_gallery.py bouncing   draws one anew; the page is written from what was stored

The page holds one number of each example; a test computes it again and compares.
"""

from __future__ import annotations

import importlib
import json
import re
import sys
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "examples" / "gallery"
PAGE = ROOT / "docs" / "tutorials" / "gallery.md"
PICTURES = ROOT / "docs" / "img" / "gallery"

#: Examples in the order of the page.
EXAMPLES = (
    "felt_pad_under_a_falling_mass",
    "felt_mallet_on_a_timpano",
    "bouncing",
    "felt_stop",
    "wool_mass",
    "fit_of_a_compression_test",
    "string_under_a_hammer",
    "key_actuator",
    "upright_stroke",
    "ablation",
    "gap_of_an_oscillator",
)

HEAD = """\
# Gallery

`tools/make_gallery.py` writes this page. Each example is one file in
[`examples/gallery`](../../examples/gallery). It draws one picture and computes one number. The
number is compared with another method: a closed form, the energy, or a smaller tolerance. A test
repeats all computations (`tests/python/docs/test_gallery.py`). To run one example:

```console
$ python examples/gallery/bouncing.py bouncing.png
```

<!-- actions to play with -->
"""


def load(name: str) -> ModuleType:
    """The module of an example."""
    if str(FOLDER) not in sys.path:
        sys.path.insert(0, str(FOLDER))
    return importlib.import_module(name)


def entry(name: str, module: ModuleType, found: Any) -> str:
    """One example as text of the page."""
    title = name.replace("_", " ").capitalize()
    lines = [f"## {title}", "", re.sub(r"\s+", " ", (module.__doc__ or "").strip()), ""]
    lines += [f"![{title}](../img/gallery/{name}.png)", ""]
    lines += [f"**{found.name}: {found.value:.4g} {found.unit}".strip() + "**", ""]
    lines += ["| checked | here | by other means | to |", "|---|---|---|---|"]
    for what, value, expected, tolerance in found.checks:
        lines.append(f"| {what} | {value:.6g} | {expected:.6g} | {tolerance:.2g} |")
    return "\n".join([*lines, "", f"[{name}.py](../../examples/gallery/{name}.py)", ""])


def main() -> None:
    from docs_pages import small_png

    chosen = sys.argv[1:] or EXAMPLES
    stored = ROOT / "build" / "gallery.json"
    texts = json.loads(stored.read_text()) if stored.is_file() and sys.argv[1:] else {}
    PICTURES.mkdir(parents=True, exist_ok=True)
    for name in chosen:
        module = load(name)
        found = module.compute()
        for fault in found.faults():
            print(f"{name}: {fault}")
        with tempfile.TemporaryDirectory() as folder:
            picture = Path(folder) / "picture.png"
            module.draw(found).savefig(picture)
            small_png(picture, PICTURES / f"{name}.png", width=900)
        texts[name] = entry(name, module, found)
        print(f"{name}: {found.name}: {found.value:.4g} {found.unit}")
    stored.parent.mkdir(exist_ok=True)
    stored.write_text(json.dumps(texts))
    PAGE.write_text("\n".join([HEAD, *(texts[n] for n in EXAMPLES)]), encoding="utf-8")


if __name__ == "__main__":
    main()
