"""Sphinx: the site of feltmb. `bash tools/docs.sh` builds it into build/docs."""

from __future__ import annotations

import os
import re
import sys
import tomllib
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
sys.path.insert(0, str(ROOT / "tools"))

import make_reference
from reference import python_api

PUBLIC_NAMES = python_api.public_names()

with (ROOT / "pyproject.toml").open("rb") as file:
    release = tomllib.load(file)["project"]["version"]

project = "feltmb"
author = "the feltmb developers"
project_copyright = author
version = release

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "numpydoc",
]
exclude_patterns = ["Thumbs.db", "**/.ipynb_checkpoints"]
source_suffix = {".md": "myst-nb", ".rst": "restructuredtext", ".ipynb": "myst-nb"}

# Markdown. Headings have the anchors that GitHub gives them, so that links work in both places.
myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath", "deflist"]

# Notebooks run in every build; a cell that fails stops it. They find examples below this folder.
os.environ["FELTMB_ROOT"] = str(ROOT)
nb_execution_mode = os.environ.get("FELTMB_DOCS_NOTEBOOKS", "force")
nb_execution_timeout = 120
nb_execution_raise_on_error = True
nb_execution_in_temp = True
nb_merge_streams = True

# The lexer of C++ does not know attributes of C++20, and colors these headers in its relaxed mode.
suppress_warnings = ["misc.highlighting_failure"]

# Python: types and defaults in the signatures, meanings below them.
autodoc_default_options = {"member-order": "bysource"}
autodoc_preserve_defaults = True
autodoc_typehints = "signature"
autosummary_generate = False
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 90
toc_object_entries_show_parents = "hide"

highlight_language = "none"

html_theme = "furo"
html_title = f"feltmb {release}"
html_copy_source = False
html_show_sourcelink = False
html_static_path: list[str] = []
#: What tools/docs.sh copies into the site.
EXTRA = ROOT / "build" / "pages"
html_extra_path = [str(EXTRA)] if EXTRA.is_dir() else []
html_theme_options = {"navigation_with_keys": True}

#: READMEs that are pages of the site, by the name of the page.
READMES = {"unmodeled": ROOT / "unmodeled" / "README.md"}
TARGET = re.compile(r"\]\((?!https?:|#)([^)\s#]+)")


def show_readme(app: Any, page: str, source: list[str]) -> None:
    """The text of a README as a page, with links as they are from here."""
    if (readme := READMES.get(page)) is None:
        return

    def moved(link: re.Match[str]) -> str:
        return f"]({os.path.relpath(readme.parent / link.group(1), DOCS)}"

    source[0] = TARGET.sub(moved, readme.read_text(encoding="utf-8"))


OUTSIDE = re.compile(r"(?<!!)\[([^\]]*)\]\(((?:\.\./)+[^)\s#]*)(#[^)\s]*)?\)")


def name_files_of_the_repository(app: Any, page: str, source: list[str]) -> None:
    """Links to files of the repository that are no pages become their names."""
    folder = (DOCS / page).parent

    def shown(link: re.Match[str]) -> str:
        target = Path(os.path.normpath(folder / link.group(2)))
        if target.is_relative_to(DOCS):
            return link.group()
        for name, readme in READMES.items():
            if target == readme:
                own = os.path.relpath(DOCS / f"{name}.md", folder)
                return f"[{link.group(1)}]({own}{link.group(3) or ''})"
        if not target.exists():
            raise ValueError(f"{page}: {link.group(2)} does not exist")
        path = target.relative_to(ROOT).as_posix()
        text = link.group(1).strip("`")
        return f"`{path}`" if text in path or text in target.name else f"{text} (`{path}`)"

    parts = re.split(r"(^```.*?^```)", source[0], flags=re.DOTALL | re.MULTILINE)
    source[0] = "".join(p if p.startswith("```") else OUTSIDE.sub(shown, p) for p in parts)


PLAYED = {"steinway45_leaded": "an upright action", "grand_action": "a grand action"}


def link_actions(app: Any, page: str, source: list[str], folder: Path = EXTRA) -> None:
    """Links to the pages of actions that tools/docs.sh made, in place of a comment."""
    up = "../" * page.count("/")
    links = [
        f'<a href="{up}actions/{name}.html">{text}</a>'
        for name, text in PLAYED.items()
        if (folder / "actions" / f"{name}.html").is_file()
    ]
    text = f"Turn, play and hear in the browser, with nothing to install: {', '.join(links)}."
    source[0] = source[0].replace("<!-- actions to play with -->", text if links else "")


def find_public_name(app: Any, env: Any, node: Any, content: Any) -> Any:
    """A type that a signature names by the module that defines it, found where it is described."""
    public = PUBLIC_NAMES.get(node.get("reftarget", ""))
    if node.get("refdomain") != "py" or public is None:
        return None
    domain = env.domains["py"]
    return domain.resolve_xref(env, node["refdoc"], app.builder, "obj", public, node, content)


def setup(app: Any) -> None:
    app.connect("builder-inited", lambda app: make_reference.write())
    app.connect("source-read", show_readme)
    app.connect("source-read", name_files_of_the_repository)
    app.connect("source-read", link_actions)
    app.connect("missing-reference", find_public_name)
