"""The reference pages, which the build of the site writes: they hold what the source has."""

import sys
from pathlib import Path

import click
import pytest

from feltmb.cli import cli
from feltmb.contact import LAWS

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "tools"))
try:
    import make_reference
    from reference import command_line, cpp, python_api, toml_files
finally:
    sys.path.remove(str(ROOT / "tools"))


def commands(command, path=("feltmb",)):
    yield path, command
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            yield from commands(command.get_command(context, name), (*path, name))


def test_every_command_has_a_section_with_its_options():
    sections = {}
    for part in command_line.page().split("\n##")[1:]:
        head, _, text = part.partition("\n")
        sections[tuple(head.strip("# ").split())] = text
    for path, command in commands(cli):
        assert path in sections
        for parameter in command.params:
            if isinstance(parameter, click.Option) and not parameter.hidden:
                assert parameter.opts[0] in sections[path], (path, parameter.opts)


def test_every_key_of_a_file_has_a_row_with_unit_limits_and_default():
    page = toml_files.page()
    for _, _, model in toml_files.schemas():
        for _, table in toml_files.tables(model, "", set()):
            for name, field in table.model_fields.items():
                assert f"| `{field.alias or name}` |" in page
    rows = [line for line in page.splitlines() if line.startswith("| `young_modulus` |")]
    assert rows
    assert all("| Pa |" in row for row in rows)
    (modes,) = [line for line in page.splitlines() if line.startswith("| `modes` | whole")]
    assert "| 40 |" in modes


def test_every_public_name_is_described_once():
    pages = python_api.pages()
    directives = [
        f"{module}.{line.split(':: ')[1]}"
        for module in python_api.MODULES
        for line in pages[f"python/{module}.rst"].splitlines()
        if line.startswith((".. autofunction::", ".. autoclass::", ".. py:data::"))
    ]
    assert len(directives) == len(set(directives))
    for module, items in python_api.offered().items():
        assert {f"{module}.{item}" for item in items} <= set(directives)
        assert f"python/{module}\n" in pages["python.rst"]
    assert python_api.public_names()["feltmb.run.results.Run"] == "feltmb.Run"


def test_every_header_is_there():
    pages = cpp.pages(ROOT / "cpp" / "include")
    headers = {p.relative_to(ROOT / "cpp" / "include") for p in ROOT.glob("cpp/include/**/*.hpp")}
    assert headers
    assert {h for h in headers if f"## {h}\n" not in "".join(pages.values())} == set()


def test_bodies_and_private_parts_are_left_out():
    header = """\
/// What it is about.
#pragma once
#define LONG(x) \\
  do { x; } while (false)
namespace feltmb {

/// A thing.
class Thing {
 public:
  explicit Thing(double x) : x_(x), y_{x} { check("}"); }
  /// [m].
  double x() const { return x_; }
  double y = f(2.0);
  Vec2 z{0.0, 1.0};

 private:
  double x_;
};

enum class Kind { kA, kB };
template <class F>
inline double twice(F f) {
  if (true) { return 2.0 * f(); }
  return 0.0;
}

}  // namespace feltmb
"""
    about, code = cpp.declarations(header)
    assert about == "What it is about."
    for text in ("explicit Thing(double x);", "double x() const;", "Vec2 z{0.0, 1.0};",
                 "double y = f(2.0);", "enum class Kind { kA, kB };", "twice(F f);"):  # fmt: skip
        assert text in code
    for text in ("x_", "return", "namespace", "pragma", "LONG", "private"):
        assert text not in code


def test_a_structure_is_a_table_and_a_function_has_its_text():
    text = """\
/// Numbers of x_y.
struct Numbers {
  double mass = 0.0;                     ///< m [kg],
                                         ///< > 0
  std::function<double(double)> law{f};  ///< of a|b
  /// Sum:
  ///   s = a_1 + b
  double sum(double a,
             double b) const;
};
"""
    shown = "\n".join(line for item in cpp.items(text) for line in cpp.rendered(item))
    assert "### Numbers" in shown
    assert r"Numbers of x\_y." in shown
    assert r"| `mass` | `double` | `0.0` | m \[kg\], \> 0 |" in shown
    assert r"| `law` | `std::function<double(double)>` | `f` | of a\\|b |" in shown
    assert "```cpp\ndouble sum(double a,\n           double b) const;\n```" in shown
    assert "```text\n  s = a_1 + b\n```" in shown


def test_pages_are_written_once_and_old_ones_go(tmp_path, monkeypatch):
    monkeypatch.setattr(make_reference, "pages", lambda: {"a.md": "new\n", "b/c.md": "c\n"})
    (tmp_path / "old.md").write_text("x")
    (tmp_path / "a.md").write_text("old\n")
    assert {p.name for p in make_reference.write(tmp_path)} == {"a.md", "c.md"}
    assert make_reference.write(tmp_path) == []
    assert sorted(p.name for p in tmp_path.rglob("*.md")) == ["a.md", "c.md"]


@pytest.mark.parametrize("name", make_reference.LINKED)
def test_pages_that_others_link_to_are_written(name):
    assert name in make_reference.pages()


def test_the_page_of_all_keys_in_git_is_that_of_the_schemas():
    page = ROOT / "docs" / "reference" / "generated" / "toml_files.md"
    text = page.read_text(encoding="utf-8")
    assert text == toml_files.page(), "run python tools/make_reference.py"
    for law in LAWS:
        assert f"| `{law}` |" in text
