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
