"""The site: what its configuration puts into pages."""

import importlib.util
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
MARK = "<!-- actions to play with -->"


@pytest.fixture(scope="module")
def conf():
    path = list(sys.path)
    spec = importlib.util.spec_from_file_location("conf_of_docs", ROOT / "docs" / "conf.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    yield module
    sys.path[:] = path


@pytest.mark.parametrize("page", ["index", "tutorials/gallery", "howto/give_away_a_web_page"])
def test_actions_are_linked_where_their_pages_were_made(conf, tmp_path, page):
    text = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")
    assert text.count(MARK) == 1
    without = [text]
    conf.link_actions(None, page, without, tmp_path)
    assert without == [text.replace(MARK, "")]
    (tmp_path / "actions").mkdir()
    for name in conf.PLAYED:
        (tmp_path / "actions" / f"{name}.html").touch()
    linked = [text]
    conf.link_actions(None, page, linked, tmp_path)
    for name in ("steinway45_leaded", "grand_action"):
        start = "../" * page.count("/")
        assert f'<a href="{start}actions/{name}.html">' in linked[0]
        script = (ROOT / "tools" / "docs.sh").read_text(encoding="utf-8")
        assert name in script


def test_a_readme_is_a_page_with_links_from_there(conf):
    source = ["stub"]
    conf.show_readme(None, "unmodeled", source)
    conf.name_files_of_the_repository(None, "unmodeled", source)
    assert source[0].startswith("# unmodeled")
    assert "](howto/first_answer.md)" in source[0]
    assert "](img/" in source[0]
    assert "](../" not in source[0]
    other = ["[what it is](../../unmodeled/README.md#ten-lines)"]
    conf.name_files_of_the_repository(None, "howto/index", other)
    assert other == ["[what it is](../unmodeled.md#ten-lines)"]
