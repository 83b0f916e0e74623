"""Moving pictures in a GIF: as many as asked, small, with forces that point the right way."""

import itertools

import numpy as np
import pytest

import feltmb
from feltmb import FileExists, InvalidParameter
from feltmb.graphics.animate import animate
from feltmb.graphics.film import Film


@pytest.fixture(scope="module")
def run(action):
    return feltmb.simulate(action, "forte")


def test_gif_has_the_asked_pictures_at_the_asked_speed(run, tmp_path):
    from PIL import Image

    told = []
    path = animate(
        run, tmp_path / "a.gif", fps=20, slowness=40, window=(0.085, 0.105), progress=told.append
    )
    with Image.open(path) as image:
        assert image.n_frames == 17  # 20 ms, 40 times slower, 20 a second, and the last
        assert image.info["duration"] == 50
        assert image.info["loop"] == 0
        pictures = []
        for i in range(image.n_frames):
            image.seek(i)
            pictures.append(np.asarray(image.convert("RGB")).astype(int))
    assert told[-1] == 1.0
    assert len(told) == 17
    first = pictures[0]
    assert tuple(first[first.shape[0] // 2, -3]) == (255, 255, 255)
    ink = float(np.mean(first.min(axis=2) < 200))
    assert 0.01 < ink < 0.4
    for a, b in itertools.pairwise(pictures):
        changed = float(np.mean(np.abs(a - b).max(axis=2) > 40))
        assert 0.0005 < changed < 0.2


@pytest.mark.slow
def test_gif_of_the_forte_stroke_is_small(run, tmp_path):
    assert animate(run, tmp_path / "forte.gif").stat().st_size < 4e6


def test_forces_point_into_the_bodies_that_move(run, action):
    film = Film(run, action, np.arange(0.088, 0.12, 2e-4))

    def arrows(number):
        i = int(np.argmax(film.forces[number]))
        film_of_one = film.contacts
        film.contacts, finger, film.finger = [number], film.finger, None
        try:
            return [head - tail for tail, head in film.arrows(i, film.poses(i))]
        finally:
            film.contacts, film.finger = film_of_one, finger

    up, player = np.array([0.0, 1.0]), np.array([1.0, 0.0])
    for number in (2, 15):  # rail on key
        (arrow,) = arrows(number)
        assert arrow @ up > 0.95 * np.linalg.norm(arrow)
    (arrow,) = arrows(6)  # string on hammer
    assert arrow @ player > 0.95 * np.linalg.norm(arrow)
    (arrow,) = arrows(5)  # let-off button on jack toe
    assert arrow @ up < -0.9 * np.linalg.norm(arrow)
    for number in (3, 4, 8):  # two bodies that move: action and reaction
        first, second = arrows(number)
        np.testing.assert_allclose(first, -second)
    longest = film.arrow_length(film.largest)
    assert film.arrow_length(film.largest / 4) == pytest.approx(longest / 2)
    assert film.arrow_length(0.0) == 0.0


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("a.mp4", {}, r"expected a name in \.gif; feltmb view"),
        ("a.gif", {"fps": 0}, "fps = 0"),
        ("a.gif", {"fps": float("nan")}, "fps: got nan"),
        ("a.gif", {"slowness": -1}, "slowness = -1"),
        ("a.gif", {"window": (1.0, 2.0)}, "holds nothing of the run"),
        ("a.gif", {"window": (0.1, 0.1)}, "holds nothing of the run"),
        ("a.gif", {"slowness": 1e5}, "the limit is 5000"),
    ],
)
def test_wrong_arguments_are_refused(run, tmp_path, name, options, message):
    with pytest.raises(InvalidParameter, match=message):
        animate(run, tmp_path / name, **options)
    assert not list(tmp_path.iterdir())


def test_an_existing_file_is_kept(run, tmp_path):
    path = tmp_path / "a.gif"
    path.write_text("mine")
    with pytest.raises(FileExists):
        animate(run, path)
    assert path.read_text() == "mine"
    animate(run, path, force=True, window=(0.09, 0.092))
    assert path.read_bytes().startswith(b"GIF89a")
