"""The release: workflow and conda recipe agree with pyproject.toml."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[3]
PROJECT, DIAGNOSIS = (
    tomllib.loads((ROOT / folder / "pyproject.toml").read_text("utf-8"))
    for folder in ("", "unmodeled")
)


def test_the_recipe_has_the_dependencies_of_the_package():
    recipe = (ROOT / "conda" / "meta.yaml").read_text("utf-8")
    run = recipe.partition("\n  run:\n")[2].partition("\n\n")[0]
    found = {tuple(line.split()[1:]) for line in run.splitlines() if line.strip() != "- python"}
    wanted = set()
    listed = [*PROJECT["project"]["dependencies"], *DIAGNOSIS["project"]["dependencies"]]
    for text in (t for t in listed if not t.startswith("unmodeled==")):
        name, least = re.fullmatch(r"([\w-]+)(>=[\d.]+)", text).groups()
        wanted.add((f"{name}-base" if name == "matplotlib" else name, least))
    assert found == wanted


def test_both_distributions_have_one_version_and_one_license():
    versions = {p["project"]["version"] for p in (PROJECT, DIAGNOSIS)}
    assert f"unmodeled=={versions.pop()}" in PROJECT["project"]["dependencies"]
    assert versions == set()
    assert (ROOT / "LICENSE").read_bytes() == (ROOT / "unmodeled" / "LICENSE").read_bytes()


def test_wheels_are_built_for_the_versions_of_the_classifiers():
    prefix = "Programming Language :: Python :: 3."
    classifiers = PROJECT["project"]["classifiers"]
    minors = [c.removeprefix(prefix) for c in classifiers if c.startswith(prefix)]
    built = PROJECT["tool"]["cibuildwheel"]["build"].split()
    assert built == [f"cp3{minor}-*" for minor in minors]
    assert minors == ["11", "12", "13", "14"]


def test_only_a_tag_publishes_and_no_token_is_named():
    text = (ROOT / ".github" / "workflows" / "release.yml").read_text("utf-8")
    publish = text.partition("\n  publish:\n")[2]
    assert "if: github.ref_type == 'tag'" in publish
    assert "id-token: write" in publish
    assert not re.search(r"secrets\.|password|api[-_]token", text)
