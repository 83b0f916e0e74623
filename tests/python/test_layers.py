"""The direction of dependence between the parts of feltmb, and what no committed file may hold."""

import ast
import functools
import graphlib
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

HERE = Path(__file__).resolve()
ROOT = HERE.parents[2]

GROUND = "errors units arguments lazy files figure style tables chain"
MODELS = f"{GROUND} data models ode"
MODEL = "errors _core params quantities fiber contact mechanism display"
RUN = f"{MODEL} run"

# part -> the parts that it may use. C++ parts are folders, Python parts are modules of the package.
# A new folder or module gets a line here; what points back is refused.
MAY_USE = {
    "C++": {
        "core": "",
        "numeric": "core",
        "fiber": "core numeric",
        "contact": "core numeric fiber",
        "beam": "core numeric",
        "modal": "core numeric",
        "ode": "core numeric",
        "planar": "core numeric fiber contact beam modal",
        "model": "core numeric fiber contact beam modal ode planar",
        "sensitivity": "core numeric fiber contact beam modal ode planar model",
        "batch": "core numeric fiber contact beam modal ode planar model sensitivity",
        "bindings": "core numeric fiber contact beam modal ode planar model sensitivity batch",
        "fmu": "core numeric fiber contact beam modal ode planar model",
        "c": "core numeric fiber contact beam modal planar",
        "wasm": "core numeric fiber contact beam modal ode planar model",
        "bench": "core numeric fiber contact beam modal ode planar model sensitivity batch",
    },
    # It knows models and records, and has never heard of a mechanism.
    "unmodeled": {
        "errors": "",
        "lazy": "",
        "arguments": "errors",
        "units": "errors arguments",
        "files": "errors",
        "blas": "",
        "figure": "",
        "tables": "errors",
        "style": "errors figure",
        "chain": "errors",
        "data": GROUND,
        "models": f"{GROUND} data",
        # The engine of equations: it has never heard of a fit, a search or a diagnosis.
        "ode": "errors arguments units chain data models",
        "fit": f"{GROUND} data models ode",
        "library": f"{MODELS} fit",
        "search": f"{MODELS} fit library",
        "pictures": f"{MODELS} fit search",
        "report": f"{MODELS} fit search pictures",
        "diagnosis": f"{MODELS} blas fit library search pictures report",
        "apart": "errors search",
        "verification": f"{MODELS} apart fit library search report diagnosis loading",
        "blind": f"{MODELS} blas fit library search diagnosis",
        "experiment": f"{MODELS} fit library search",
        "loading": f"{MODELS} fit library search experiment",
        "__init__": f"{MODELS} fit library search report experiment diagnosis blind loading "
        "verification",
        "cli": f"{MODELS} blas fit library search report experiment diagnosis blind loading "
        "__init__",
        # It has the options of the command line in a form.
        "page": f"{MODELS} fit search report loading diagnosis cli __init__",
        "__main__": "cli",
    },
    # A mechanism and a stroke become a run; adapters make a mechanism a model of unmodeled.
    "feltmb": {
        "errors": "",
        "display": "",
        "_core": "",
        "params": "",
        "quantities": "",
        "fiber": "_core params quantities",
        "contact": "_core quantities fiber",
        "mechanism": "_core params quantities fiber contact display",
        "felt": RUN,
        "run": MODEL,
        "adapters": RUN,
        "gap": "",
        "keyboard": f"{RUN} action graphics",
        "extension": f"{RUN} adapters cli",
        "action": f"{RUN} adapters graphics",
        "graphics": RUN,
        "live": f"{RUN} adapters action graphics __init__",
        "__init__": f"{RUN} felt adapters action graphics gap",
        "cli": f"{RUN} felt adapters action graphics keyboard live __init__",
        "__main__": "cli",
    },
}
PACKAGES = {"feltmb": Path("python/feltmb"), "unmodeled": Path("unmodeled/src/unmodeled")}

# Libraries that only some parts of the core may include.
ONLY_IN = {
    r"pybind11/|Python\.h": ("bindings", "bench"),
    r"(cvodes?|sundials|nvector|sunmatrix|sunlinsol|sunnonlinsol)/": ("ode",),
}

INCLUDE = re.compile(r'^\s*#\s*include\s*([<"])([^>"]+)[>"]', re.MULTILINE)

MACHINE_PATH = re.compile(r"(?<![\w.}~-])/(?:work|root|home|Users)(?![\w-])")
PACKAGE_HOST = re.compile(
    r"pypi\.org|pythonhosted\.org|(?:deb|security|snapshot|ftp)\.debian\.org"
    r"|npmjs\.(?:org|com)|anaconda\.org|archive\.ubuntu\.com"
)

#: Words that were replaced by the standard terms of the field (docs/reference/notation.md,
#: glossary), and must not come back. A word is added when its last use is gone.
REPLACED_WORD = re.compile(
    r"(?<![\w-])(?:nominals?|(?!fmi)\w*Nominal\w*|foresee[ns]?|foreseeing|foresight"
    r"|foretells?|foretelling|foretold|[Ss]hots?|[Nn]ats|[Uu]nknown rests?|UNKNOWN RESTS?|[Ll]ouder"
    r"|[Aa]mended|gap_subjects|load_subject|make_shot|observe_lanes|[Ff]iner|cautions|[Cc]ooled"
    r"|[Tt]wins?|[Mm]end(?:s|ed|ing)?|[Ll]uck(?:y|ily)?|[Vv]alleys?)(?![\w-])"
)
#: Files that tell what was replaced or what other programs say, and this one.
TELLS_OLD_WORDS = {
    "CHANGELOG.md",
    "docs/howto/first_answer.md",
    "docs/reference/notation.md",
    "tests/python/test_layers.py",
}


def check_use(language: str, file: str, user: str, used: str) -> Iterator[str]:
    """Yield what is wrong when a file of the part `user` uses the part `used`."""
    table = MAY_USE[language]
    for part in (user, used):
        if part not in table:
            yield f'{file}: {language} part "{part}" is unknown; add it to MAY_USE in {HERE.name}'
            return
    if used != user and used not in table[user].split():
        yield f'{file}: "{user}" may not use "{used}", only: {table[user] or "nothing"}'


def cpp_part(path: Path) -> str:
    """Part of a C++ file, given by its path inside the repository."""
    match path.parts:
        case ["cpp", "src", part, _, *_] | ["cpp", "include", "feltmb", part, _, *_]:
            return part
        case ["cpp", "bindings" | "fmu" | "c" | "wasm" as part, *_]:
            return part
        case ["bench", *_]:
            return "bench"
    return str(path)


def cpp_faults(root: Path) -> Iterator[str]:
    files = [f for top in ("cpp", "bench") for f in sorted((root / top).rglob("*.[ch]pp"))]
    for file in files:
        path = file.relative_to(root)
        user = cpp_part(path)
        yield from check_use("C++", str(path), user, user)
        for mark, name in INCLUDE.findall(file.read_text(encoding="utf-8")):
            for library, parts in ONLY_IN.items():
                if re.match(library, name) and user not in parts:
                    yield f"{path}: includes {name}, which only {', '.join(parts)} may include"
                elif re.match(library, name) and path.parts[:2] == ("cpp", "include"):
                    yield f"{path}: includes {name}, which an installed library may lack"
            if name.startswith("feltmb/"):
                included = Path("cpp/include", name)
            elif mark == '"' and (file.parent / name).exists():
                included = (file.parent / name).resolve().relative_to(root.resolve())
            else:
                continue
            yield from check_use("C++", str(path), user, cpp_part(included))


def imported_names(tree: ast.AST, module: list[str]) -> Iterator[list[str]]:
    """Yield the full names that a module imports; `module` is its own, split at the dots.

    Imports inside functions count as well: they are late, but they are dependence. Imports for
    annotations only (`if TYPE_CHECKING:`) do not count.
    """
    if isinstance(tree, ast.If) and ast.unparse(tree.test).endswith("TYPE_CHECKING"):
        return
    if isinstance(tree, ast.Import):
        yield from (alias.name.split(".") for alias in tree.names)
    elif isinstance(tree, ast.ImportFrom):
        base = module[: -tree.level] if tree.level else []
        base = base + (tree.module.split(".") if tree.module else [])
        yield from ([*base, alias.name] for alias in tree.names)
    for child in ast.iter_child_nodes(tree):
        yield from imported_names(child, module)


@functools.cache
def parsed(file: Path) -> ast.Module:
    """Tree of a source, made once for all checks of it."""
    return ast.parse(file.read_text(encoding="utf-8"))


def python_faults(root: Path) -> Iterator[str]:
    for package, folder in PACKAGES.items():
        table = MAY_USE[package]
        for file in sorted((root / folder).rglob("*.py")):
            path = str(file.relative_to(root))
            module = [package, *file.relative_to(root / folder).with_suffix("").parts]
            user = module[1]
            yield from check_use(package, path, user, user)
            for name in imported_names(parsed(file), module):
                if package == "unmodeled" and name[0] == "feltmb":
                    yield f"{path}: unmodeled may not use feltmb"
                if name[0] != package:
                    continue
                inside = len(name) > 1 and (name[1] in table or is_part(root / folder, name[1]))
                yield from check_use(package, path, user, name[1] if inside else "__init__")


#: The compiled core, and attributes of objects of Python's library.
NOT_OURS = ("_core", "_is_protocol", "_max_workers")


def private_faults(root: Path) -> Iterator[str]:
    """Private attributes and names that are used in another file than that which binds them.

    Methods of a class may use those of its base class, on ``self`` and its copy ``out``.
    """
    for folder in PACKAGES.values():
        for file in sorted((root / folder).rglob("*.py")):
            path, bound, used = file.relative_to(root), set(), []
            for node in ast.walk(parsed(file)):
                if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
                    bound.add(node.name)
                elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                    bound.add(node.id)
                elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
                    bound.add(node.attr)
                elif isinstance(node, ast.Attribute):
                    used.append((ast.unparse(node.value), node.attr, node.lineno))
                elif isinstance(node, ast.ImportFrom):
                    used += [(node.module, alias.name, node.lineno) for alias in node.names]
                elif isinstance(node, ast.Call) and ast.unparse(node.func) in (
                    "getattr",
                    "setattr",
                ):
                    name = node.args[1]
                    if isinstance(name, ast.Constant):
                        used.append((ast.unparse(node.args[0]), name.value, node.lineno))
            for owner, name, line in used:
                private = re.fullmatch("_[a-z]\\w*", name) and name not in NOT_OURS
                if private and name not in bound and owner not in ("self", "out", "sys", "_core"):
                    yield f"{path}:{line}: {owner}.{name} is private to another file"


def is_part(package: Path, name: str) -> bool:
    return (package / name).is_dir() or (package / f"{name}.py").exists()


def committed_files(root: Path) -> list[Path]:
    """Files that git knows; in an unpacked archive all files but what the tools write."""
    listing = subprocess.run(
        ["git", "-C", str(root), "ls-files", "-z"], capture_output=True, text=True, check=False
    )
    if listing.returncode == 0 and listing.stdout:
        return [root / name for name in listing.stdout.split("\0") if (root / name).is_file()]
    written = {"build", "out", "dist", "__pycache__"}
    return [
        file
        for file in root.rglob("*")
        if file.is_file()
        and not any(p in written or p.startswith(".") for p in file.relative_to(root).parts[:-1])
    ]


def text_faults(file: Path, root: Path) -> Iterator[str]:
    data = file.read_bytes()
    text = data.decode(errors="replace")
    if b"\0" in data or not any(
        p.search(text) for p in (MACHINE_PATH, PACKAGE_HOST, REPLACED_WORD)
    ):
        return
    for number, line in enumerate(text.splitlines(), start=1):
        where = f"{file.relative_to(root)}:{number}"
        if found := MACHINE_PATH.search(line):
            yield f"{where}: path of a machine {found.group()}"
        if found := PACKAGE_HOST.search(line):
            yield f"{where}: package host {found.group()}"
        if file.relative_to(root).as_posix() in TELLS_OLD_WORDS:
            continue
        if found := REPLACED_WORD.search(line):
            yield f"{where}: {found.group()} was replaced, see docs/reference/notation.md"


@pytest.mark.parametrize("language", MAY_USE)
def test_table_has_no_cycle_and_no_unknown_part(language):
    table = {part: set(used.split()) for part, used in MAY_USE[language].items()}
    graphlib.TopologicalSorter(table).prepare()
    assert set().union(*table.values()) <= set(table)


def test_every_part_of_the_table_exists():
    for package, folder in PACKAGES.items():
        names = {p.stem for p in (ROOT / folder).iterdir()} | {"__init__"}
        assert set(MAY_USE[package]) <= names
    folders = {p.name for top in ("include/feltmb", "src") for p in (ROOT / "cpp" / top).iterdir()}
    assert set(MAY_USE["C++"]) <= folders | {"bindings", "fmu", "c", "wasm", "bench"}


def imports_of_modules(package: Path) -> dict[str, set[str]]:
    """Module -> modules that it imports, anywhere in its text, for annotations too.

    Packages count as what they re-export only where a module imports from the package itself.
    """
    files = {
        ".".join((package.name, *file.relative_to(package).with_suffix("").parts)).removesuffix(
            ".__init__"
        ): file
        for file in package.rglob("*.py")
    }
    found: dict[str, set[str]] = {}
    for module, file in files.items():
        found[module] = set()
        for node in ast.walk(parsed(file)):
            names: list[str] = []
            if isinstance(node, ast.ImportFrom) and node.module:
                names = [f"{node.module}.{alias.name}" for alias in node.names]
                names = [n if n in files else node.module for n in names]
            elif isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            found[module] |= {n for n in names if n in files and n not in (module, package.name)}
    return found


@pytest.mark.parametrize("package", PACKAGES)
def test_modules_have_no_circle(package):
    graph = imports_of_modules(ROOT / PACKAGES[package])
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as circle:
        pytest.fail(" -> ".join(circle.args[1]))


def test_circle_is_found(tmp_path):
    package = tmp_path / "feltmb"
    package.mkdir()
    (package / "a.py").write_text("def f():\n    from feltmb.b import x")
    (package / "b.py").write_text("if TYPE_CHECKING:\n    from feltmb.a import y")
    with pytest.raises(graphlib.CycleError):
        graphlib.TopologicalSorter(imports_of_modules(package)).prepare()


def test_private_name_is_found(tmp_path):
    package = tmp_path / PACKAGES["feltmb"]
    package.mkdir(parents=True)
    (package / "a.py").write_text("from feltmb.b import _c\nx = _c()\nself._d = 1\nself._e(_d)")
    (package / "b.py").write_text("def _c(y):\n    return y._e, getattr(y, '_f', None)")
    assert list(private_faults(tmp_path)) == [
        "python/feltmb/a.py:1: feltmb.b._c is private to another file",
        "python/feltmb/b.py:2: y._e is private to another file",
        "python/feltmb/b.py:2: y._f is private to another file",
    ]


def none(faults: Iterator[str]) -> None:
    found = list(dict.fromkeys(faults))
    assert not found, "\n".join(["", *found])


def test_cpp_includes_point_one_way():
    none(cpp_faults(ROOT))


def test_python_imports_point_one_way():
    none(python_faults(ROOT))


def test_no_private_name_of_another_file():
    none(private_faults(ROOT))


def test_no_machine_path_no_package_host_and_no_replaced_word():
    none(fault for file in committed_files(ROOT) for fault in text_faults(file, ROOT))


# ---------------------------------------------------------------- the checks themselves


@pytest.mark.parametrize(
    ("path", "text", "fault"),
    [
        ("cpp/src/core/a.cpp", '#include "feltmb/numeric/b.hpp"', '"core" may not use "numeric"'),
        ("cpp/include/feltmb/fiber/a.hpp", "#include <feltmb/contact/b.hpp>", 'not use "contact"'),
        ("cpp/src/contact/a.cpp", '  #  include "feltmb/planar/b.hpp"', 'not use "planar"'),
        ("cpp/src/planar/a.cpp", '#include "feltmb/bindings/b.hpp"', 'not use "bindings"'),
        ("cpp/src/fibre/a.cpp", "", 'part "fibre" is unknown; add it'),
        ("cpp/src/fiber/a.cpp", '#include "feltmb/felt/b.hpp"', 'part "felt" is unknown; add it'),
        ("cpp/src/a.cpp", "", 'part "cpp/src/a.cpp" is unknown'),
        (
            "cpp/src/model/a.cpp",
            "#include <pybind11/pybind11.h>",
            "only bindings, bench may include",
        ),
        ("cpp/include/feltmb/ode/a.hpp", "#include <cvodes/cvodes.h>", "an installed library"),
        ("cpp/src/planar/a.cpp", "#include <cvodes/cvodes.h>", "only ode may include"),
        ("python/feltmb/run/a.py", "from feltmb.adapters import model", 'not use "adapters"'),
        ("python/feltmb/fiber/a.py", "from ..run import simulate", 'not use "run"'),
        ("python/feltmb/run/__init__.py", "from .. import adapters", 'not use "adapters"'),
        ("python/feltmb/run/a.py", "def f():\n    import feltmb.cli", 'not use "cli"'),
        ("python/feltmb/errors.py", "from feltmb import Config", 'not use "__init__"'),
        ("python/feltmb/knit/a.py", "", 'part "knit" is unknown; add it'),
        ("python/feltmb/errors.py", "import feltmb.knit", 'not use "__init__"'),
        ("unmodeled/src/unmodeled/fit/a.py", "from ..search import fit", 'not use "search"'),
        ("unmodeled/src/unmodeled/fit/a.py", "from feltmb.run import Run", "may not use feltmb"),
    ],
)
def test_fault_is_found(tmp_path, path, text, fault):
    file = tmp_path / path
    file.parent.mkdir(parents=True)
    file.write_text(text)
    faults = [*cpp_faults(tmp_path), *python_faults(tmp_path)]
    assert len(faults) == 1
    assert fault in faults[0]
    assert faults[0].startswith(path)


@pytest.mark.parametrize(
    ("path", "text"),
    [
        ("cpp/src/contact/a.cpp", '#include "feltmb/fiber/b.hpp"\n#include <vector>'),
        ("cpp/src/ode/a.cpp", "#include <cvodes/cvodes.h>"),
        ("cpp/bindings/a.cpp", '#include "a.hpp"\n#include <pybind11/numpy.h>'),
        ("bench/speed/a.cpp", "#include <feltmb/batch/b.hpp>"),
        ("python/feltmb/run/a.py", "from .b import x\nfrom ..mechanism import M\nimport numpy"),
        ("unmodeled/src/unmodeled/search/a.py", "from ..fit import Fit\nimport numpy"),
        ("python/feltmb/cli/a.py", "from feltmb import __version__, simulate"),
        ("python/feltmb/errors.py", "if TYPE_CHECKING:\n    from feltmb.run.results import Run"),
        ("python/feltmb/__init__.py", "from .run import x\nfrom . import graphics"),
    ],
)
def test_permitted_use_passes(tmp_path, path, text):
    file = tmp_path / path
    file.parent.mkdir(parents=True)
    file.write_text(text)
    assert [*cpp_faults(tmp_path), *python_faults(tmp_path)] == []


@pytest.mark.parametrize("folder", ["work", "root", "home", "Users"])
@pytest.mark.parametrize("text", ["see {}/a/b.txt", 'open("{}/x")', "{}", "cd {};"])
def test_machine_path_is_found(tmp_path, folder, text):
    file = tmp_path / "a.md"
    file.write_text(text.format("/" + folder))
    assert list(text_faults(file, tmp_path)) == [f"a.md:1: path of a machine /{folder}"]


def test_package_host_is_found(tmp_path):
    file = tmp_path / "a.md"
    host = ".".join(["pypi", "org"])
    file.write_text(f"one\nhttps://{host}/simple")
    assert list(text_faults(file, tmp_path)) == [f"a.md:2: package host {host}"]


@pytest.mark.parametrize("text", ["the nominal fit", "OdeNominal", "to foresee", "it foretold"])
def test_replaced_word_is_found(tmp_path, text):
    (tmp_path / "a.md").write_text(text)
    (fault,) = text_faults(tmp_path / "a.md", tmp_path)
    assert "was replaced" in fault


@pytest.mark.parametrize("text", ["a denominator", "nominally", "the model"])
def test_words_that_only_look_like_one_pass(tmp_path, text):
    (tmp_path / "a.md").write_text(text)
    assert list(text_faults(tmp_path / "a.md", tmp_path)) == []


@pytest.mark.parametrize(
    "text", ["energy/work", "$HOME/work", "../home/x", "~/work", "roots/root", "/workers"]
)
def test_other_text_passes(tmp_path, text):
    file = tmp_path / "a.md"
    file.write_text(text)
    assert list(text_faults(file, tmp_path)) == []


def test_only_packages_and_documented_modules_list_public_names():
    """What other modules list is for nobody; the pages and the reference say what is public."""
    pages = [ROOT / "README.md", ROOT / "tools" / "reference" / "python_api.py"]
    facade = (ROOT / "python" / "feltmb" / "__init__.py").read_text(encoding="utf-8")
    attributes = set(re.findall(r'"\w+": "([\w.]+)",', facade))
    for folder in ("docs", "examples", "unmodeled/examples"):
        pages += [p for end in ("md", "ipynb", "py") for p in (ROOT / folder).rglob(f"*.{end}")]
    text = "\n".join(p.read_text(encoding="utf-8") for p in pages)
    listing = [
        ".".join(p.relative_to(source).with_suffix("").parts)
        for source in (ROOT / "python", ROOT / "unmodeled" / "src")
        for p in source.rglob("*.py")
        if p.name != "__init__.py" and "\n__all__ = " in p.read_text(encoding="utf-8")
    ]
    assert listing
    unknown = [name for name in listing if not re.search(rf"\b{re.escape(name)}\b", text)]
    assert {name.removeprefix("feltmb.") for name in unknown} <= attributes  # feltmb.animate, ...


def chains(text):
    """Pairs (used, user) of the arrows of CONTRIBUTING.md: a, { b → c, d } → e."""
    tokens = re.findall(r"→|,|[{}]|\w+", text)

    def group(at):
        """Firsts and lasts of a list of chains, its pairs, and the place behind it."""
        firsts, lasts, pairs, chain = [], [], [], []
        while at < len(tokens) and tokens[at] != "}":
            if tokens[at] == "→":
                at += 1
            elif tokens[at] == ",":
                firsts, lasts, chain = firsts + chain[0], lasts + chain[1], []
                at += 1
            else:
                if tokens[at] == "{":
                    first, last, inner, at = group(at + 1)
                    pairs += inner
                else:
                    first, last = [tokens[at]], [tokens[at]]
                if chain:
                    pairs += [(a, b) for a in chain[1] for b in first]
                chain = (chain[0] if chain else first, last)
                at += 1
        return firsts + chain[0], lasts + chain[1], pairs, at

    return group(0)[2]


def test_the_arrows_of_contributing_are_those_of_the_table():
    text = (ROOT / "CONTRIBUTING.md").read_text("utf-8").partition("## Layers")[2]
    cpp, python = re.findall(r"```\n(.*?)```", text, re.DOTALL)[:2]
    package, checked_pairs = "C++", 0
    for line in [*cpp.splitlines(), *python.splitlines()]:
        name, _, chain = line.rpartition(":")
        package = name.strip() or package
        for used, user in chains(chain):
            if user == "Python" or used == "unmodeled":
                continue
            checked_pairs += 1
            assert used in MAY_USE[package][user].split(), f"{package}: {used} → {user}"
    assert checked_pairs > 35
