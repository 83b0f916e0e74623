"""The commands and examples of the documentation run, and print what the pages show."""

import importlib.util
import os
import re
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]


def load_tool(name):
    spec = importlib.util.spec_from_file_location(name, ROOT / "tools" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look themselves up
    spec.loader.exec_module(module)
    return module


tool = load_tool("docs_pages")

#: Pages without commands that end; tests/python/test_changes.py applies the second.
SILENT = ("index", "add_a_command", "live", "install")
HOWTO = sorted(
    str(p.relative_to(ROOT)) for p in (ROOT / "docs" / "howto").glob("*.md") if p.stem not in SILENT
)
TUTORIALS = [
    f"docs/tutorials/{n}.md"
    for n in ("first_stroke", "first_felt", "first_diagnosis", "first_machine", "answers")
]
PAGES = [
    "README.md",
    "unmodeled/README.md",
    *TUTORIALS,
    "docs/explanation/gap.md",
    "docs/explanation/tracing.md",
    "docs/reference/mechanism_files.md",
    *HOWTO,
]


def begins_slow(page):
    """Whether no block of a page comes before what takes long."""
    return next(b.kind for b in tool.blocks(ROOT / page)) == "slow"


@pytest.mark.parametrize("page", [p for p in PAGES if not begins_slow(p)])
def test_page_shows_what_comes(page, tmp_path):
    assert tool.run_page(ROOT / page, tmp_path, slow=False) > 0


def test_links_of_the_pages_lead_somewhere():
    patterns = ("*.md", "docs/**/*.md", "examples/*.md", "unmodeled/*.md")
    pages = [p for pattern in patterns for p in ROOT.glob(pattern)]
    # The build of the site writes the reference and checks the links into it.
    generated = ROOT / "docs" / "reference" / "generated"
    lost = []
    for page in (p for p in pages if generated not in p.parents):
        text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", text):
            file = Path(os.path.normpath(page.parent / target))
            if "://" not in target and not file.exists() and file.parent != generated:
                lost.append(f"{page.relative_to(ROOT)}: {target}")
    assert lost == []


@pytest.mark.slow
@pytest.mark.parametrize("page", [p for p in PAGES if "<!-- slow -->" in (ROOT / p).read_text()])
def test_slow_part_of_page_shows_what_comes(page, tmp_path):
    assert tool.run_page(ROOT / page, tmp_path, slow=True) > 0


# ---------------------------------------------------------------- the comparison itself


@pytest.mark.parametrize(
    ("shown", "comes"),
    [
        (["a 1.00"], ["a   1.001"]),
        (["a 1.0e-05"], ["a 1.001e-05"]),
        (["one", "...", "ten 10 ms"], ["one", "two", "three", "ten 10 ms"]),
        (["name   x", "──────"], ["name x", "─────────"]),
        (["a", "..."], ["a", "b", "c"]),
        ([], []),
    ],
)
def test_same_output_passes(shown, comes):
    assert tool.compare(shown, comes, 2e-3) == ""


@pytest.mark.parametrize(
    ("shown", "comes"),
    [
        (["a 1.00"], ["a 1.02"]),
        (["a 1.0e-05"], ["a 1.1e-05"]),
        (["a"], ["b"]),
        (["a"], ["a", "b"]),
        (["a", "b"], ["a"]),
        (["a", "...", "z"], ["a", "b"]),
        (["1 of 3"], ["1 of"]),
    ],
)
def test_other_output_is_found(shown, comes):
    assert tool.compare(shown, comes, 2e-3)


def write(tmp_path, text):
    page = tmp_path / "page.md"
    page.write_text(text)
    folder = tmp_path / "in"
    folder.mkdir()
    return page, folder


def test_a_page_that_lies_is_found(tmp_path):
    page, folder = write(tmp_path, "```console\n$ echo 3.0 mm\n4.0 mm\n```\n")
    before = os.environ.get("COLUMNS")
    with pytest.raises(tool.Mismatch, match=r"page.md:2: \$ echo 3.0 mm"):
        tool.run_page(page, folder)
    assert os.environ.get("COLUMNS") == before


def test_an_example_that_fails_is_found_at_its_line(tmp_path):
    page, folder = write(
        tmp_path, "text\n\n```python\nx = 1\n```\n\n```python\nassert x == 2\n```\n"
    )
    with pytest.raises(tool.Mismatch, match=r"page\.md:8: AssertionError"):
        tool.run_page(page, folder)


def test_what_comes_is_written_into_the_page(tmp_path):
    text = (
        "<!-- file a.txt -->\n```text\none\ntwo\nthree\n```\n"
        "```console\n$ cat a.txt\nx\n...\n$ head -1 a.txt\n```\n"
        "```python\nprint(1.5)\n```\n<!-- printed -->\n```text\n```\n"
    )
    page, folder = write(tmp_path, text)
    assert tool.run_page(page, folder, write=True) == 3
    shown = page.read_text()
    assert "$ cat a.txt\none\n...\n$ head -1 a.txt\none\n```" in shown
    assert "```text\n1.5\n```" in shown
    assert tool.run_page(page, folder) == 3


NUMBERED = "".join(f"printf '%s {k}\\n' {word}\n" for k, word in enumerate("abcdefg", 1))


@pytest.mark.parametrize(
    ("shown", "written"),
    [
        ("x\n...\nc 0\n...\ne 0\nf 0\n...\n", "a 1\n...\nc 3\n...\ne 5\nf 6\n...\n"),
        ("...\nb 0\n...\ng 0\n", "...\nb 2\n...\ng 7\n"),
        ("...\nb 0\n...\nf x\n", "...\nb 2\n...\nf 6\ng 7\n"),
        ("a\n...\nz 1\n", "a 1\n...\ng 7\n"),
    ],
)
def test_all_parts_between_left_out_lines_are_written(tmp_path, shown, written):
    page, folder = write(tmp_path, f"```console\n$ sh letters.sh\n{shown}```\n")
    (folder / "letters.sh").write_text(NUMBERED)
    tool.run_page(page, folder, write=True)
    assert page.read_text() == f"```console\n$ sh letters.sh\n{written}```\n"
    tool.run_page(page, folder)


def test_a_part_between_left_out_lines_that_does_not_come_any_more_is_not_lost(tmp_path):
    text = "```console\n$ sh letters.sh\na 0\n...\nz 0\n...\ng 0\n```\n"
    page, folder = write(tmp_path, text)
    (folder / "letters.sh").write_text(NUMBERED)
    with pytest.raises(tool.Mismatch, match=r'page\.md:2: \$ sh letters\.sh: no line like "z 0"'):
        tool.run_page(page, folder, write=True)
    assert page.read_text() == text


def test_not_run_and_slow_parts_are_left_out(tmp_path):
    text = (
        "<!-- not run: why -->\n```console\n$ false x\n```\n"
        "<!-- slow -->\n```console\n$ echo\n```\n"
    )
    page, folder = write(tmp_path, text)
    assert tool.run_page(page, folder, slow=False) == 0


def test_no_text_installs_feltmb_from_an_index():
    """It is in no index; somebody else's package could get the name."""
    told = re.compile(r"pip install (?:['\"]?[-\w.,\[\]]+['\"]? )*['\"]?feltmb\b")
    folders = ("docs", "examples", "python", "tools", "bench", "tests/data")
    files = [*ROOT.glob("*.md"), *(p for f in folders for p in (ROOT / f).rglob("*"))]
    kinds = (".md", ".py", ".sh", ".toml", ".ipynb", ".html", ".js")
    assert [
        str(p.relative_to(ROOT))
        for p in files
        if p.suffix in kinds and told.search(p.read_text(encoding="utf-8"))
    ] == []


def test_the_first_command_installs_the_packages_of_the_live_page():
    setup = (ROOT / "tools" / "setup.sh").read_text(encoding="utf-8")
    extras = re.findall(r"\bextra='?(\w+)", setup)
    packages = [
        tomllib.loads((ROOT / folder / "pyproject.toml").read_text())["project"][
            "optional-dependencies"
        ]
        for folder in ("", "unmodeled")
    ]
    assert extras == ["live", "test"]
    assert any("live" in p for p in packages[0]["test"])
    page = (ROOT / "docs" / "howto" / "install.md").read_text(encoding="utf-8")
    tables = page.partition("| extra of `feltmb` |")[2].split("| extra of `unmodeled` |")
    for table, extras in zip(tables, packages, strict=True):
        assert set(re.findall(r"^\| `(\w+)` \|", table, flags=re.MULTILINE)) == set(extras)
