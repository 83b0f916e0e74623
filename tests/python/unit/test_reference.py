"""docs/reference is what the source says; the parser of the headers leaves out what it should."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "tools"))
try:
    from reference import command_line, cpp, python_api, toml_files
finally:
    sys.path.remove(str(ROOT / "tools"))

PAGES = {
    "command_line.md": command_line.page,
    "toml_files.md": toml_files.page,
    "python.md": python_api.page,
    "cpp.md": lambda: cpp.page(ROOT / "cpp" / "include"),
}


@pytest.mark.parametrize("name", PAGES)
def test_page_is_up_to_date(name):
    page = (ROOT / "docs" / "reference" / name).read_text(encoding="utf-8")
    assert page == PAGES[name](), "out of date: run python tools/make_reference.py"


def test_every_header_and_every_command_is_there():
    page = (ROOT / "docs" / "reference" / "cpp.md").read_text(encoding="utf-8")
    headers = {
        str(p.relative_to(ROOT / "cpp" / "include")) for p in ROOT.glob("cpp/include/**/*.hpp")
    }
    assert headers
    assert {h for h in headers if f"### {h}\n" not in page} == set()


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


def test_a_stale_page_is_named():
    script = (
        "import sys; sys.path.insert(0, sys.argv[1]); import make_reference as m; "
        "m.pages = lambda: {'README.md': 'other'}; sys.argv = ['x', '--check']; sys.exit(m.main())"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, str(ROOT / "tools")],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 1
    assert "docs/reference/README.md is out of date" in done.stdout
