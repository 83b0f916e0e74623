"""The viewer on a fresh page: keys without a click, narrow screens, fingers that scroll."""

import pytest

from feltmb.graphics.viewer import assets, fragment, view

VIEWER = "document.querySelector('.feltmb-view').viewer"


@pytest.fixture(scope="module")
def pages(forte, piano, tmp_path_factory):
    """One page with two runs, one with six of long names, one with two viewers."""
    folder = tmp_path_factory.mktemp("viewer")
    runs = [forte, piano] * 3
    long = [f"a_very_long_name_of_a_run_measured_in_the_laboratory_{i}" for i in range(6)]
    both = folder / "both.html"
    part = fragment(forte)
    both.write_text(
        "<!DOCTYPE html><html><head><meta charset='utf-8'></head><body>"
        f"{assets()}<input id='own'>{part}<p style='height: 3000px'>text</p>{part}</body></html>"
    )
    return {
        "two": view([forte, piano], folder / "two.html"),
        "six": view(runs, folder / "six.html", names=long),
        "both": both,
    }


@pytest.fixture
def fresh(browser, pages):
    """fresh(page, width): a page that was loaded and not touched."""

    def load(page, width=1280, height=844):
        browser.resize(width, height)
        browser.open(pages[page])
        return browser

    yield load
    browser.resize(1280, 900)


def now(browser, which=0):
    return browser.run(f"document.querySelectorAll('.feltmb-view')[{which}].viewer.now")


def test_keys_work_on_a_fresh_page(fresh):
    page = fresh("two")
    start = now(page)
    page.press("ArrowRight")
    step = now(page) - start
    assert step > 0.0
    page.press("ArrowLeft")
    assert now(page) == pytest.approx(start)
    page.press(" ", "Space", " ")
    assert page.run(f"{VIEWER}.playing") is True
    assert page.run("scrollY") == 0
    page.press(" ", "Space", " ")
    assert page.run(f"{VIEWER}.playing") is False
    page.press("End")
    assert now(page) > start + 100.0 * step
    page.press("Home")
    assert now(page) == pytest.approx(start)


def test_keys_of_the_browser_and_of_a_field_stay_theirs(fresh):
    page = fresh("both")
    before = [now(page, i) for i in (0, 1)]
    page.press("ArrowRight")  # which of two viewers is meant is not known before one was used
    assert [now(page, i) for i in (0, 1)] == before
    page.run("document.querySelectorAll('.feltmb-view')[0].focus()")
    page.run("document.activeElement.blur()")
    page.press("ArrowRight")
    assert now(page, 0) > before[0]
    assert now(page, 1) == before[1]
    here = now(page, 0)
    page.run("document.getElementById('own').focus()")
    page.press("ArrowRight")
    page.run("document.activeElement.blur()")
    for modifiers in (1, 2, 4):  # Alt, Control, Meta
        for kind in ("keyDown", "keyUp"):
            page.call("Input.dispatchKeyEvent", type=kind, key="ArrowDown", code="ArrowDown")
            page.call(
                "Input.dispatchKeyEvent", type=kind, key="End", code="End", modifiers=modifiers
            )
    assert now(page, 0) == here
    page.run("scrollTo(0, 2500)")  # the viewer that was used is out of sight: the page has the keys
    page.press("ArrowRight")
    assert now(page, 0) == here


@pytest.mark.parametrize("width", [390, 320])
@pytest.mark.parametrize("name", ["two", "six"])
def test_nothing_scrolls_sideways_on_a_narrow_screen(fresh, name, width):
    page = fresh(name, width)
    assert page.run("document.documentElement.scrollWidth") <= width
    beyond = page.run(
        "[...document.querySelectorAll('.feltmb-view *')].filter(e => "
        "e.getBoundingClientRect().right > innerWidth + 0.5).map(e => e.className)"
    )
    assert beyond == []


def test_a_finger_may_scroll_the_page_over_every_picture(fresh):
    """The headless browser makes no scrolling of touches; what the browser is told is looked at."""
    page = fresh("two", 390)
    actions = "[...document.querySelectorAll('canvas')].map(c => getComputedStyle(c).touchAction)"
    found = page.run(actions)
    assert len(found) > 3
    assert all("pan-y" in each.split() for each in found)
    # Enlarged, a finger moves the mechanism, until it is seen whole again.
    page.run(f"{VIEWER}.stage.magnify(2)")
    assert page.run(actions)[0] == "none"
    page.run(f"{VIEWER}.stage.reset()")
    assert page.run(actions) == found


def _finger(page, *events):
    """Pointer events of a finger over the first curve: (name, place from the left in pixels)."""
    for name, x in events:
        page.run(
            "(c => { const b = c.getBoundingClientRect(); c.setPointerCapture = () => {};"
            f"c.dispatchEvent(new PointerEvent('{name}', {{bubbles: true, pointerId: 5, "
            f"pointerType: 'touch', clientX: b.x + {x}, clientY: b.y + 20}})); }})"
            "(document.querySelector('.fv-panel canvas'))"
        )


def test_a_swipe_that_scrolls_leaves_the_time_and_the_play(fresh):
    page = fresh("two", 390)
    time = now(page)
    page.run(f"{VIEWER}.toggle(true); {VIEWER}.slow.value = 1e6")
    _finger(page, ("pointerdown", 200), ("pointercancel", 200))
    assert page.run(f"{VIEWER}.playing") is True
    page.run(f"{VIEWER}.toggle(false)")
    assert now(page) == pytest.approx(time, abs=0.1)


def test_a_tap_and_a_drag_along_a_curve_move_the_time(fresh):
    page = fresh("two", 390)
    _finger(page, ("pointerdown", 150), ("pointerup", 150))
    tapped = now(page)
    assert tapped > 50.0
    _finger(page, ("pointerdown", 150), ("pointermove", 250))
    assert now(page) > tapped + 20.0
    _finger(page, ("pointerup", 250), ("pointermove", 100))
    assert now(page) > tapped + 20.0
