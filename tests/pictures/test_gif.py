"""Animations, read back with Pillow."""

import io
from itertools import pairwise

import numpy as np
import pytest
from helpers.scenes import cloth, document, sphere

from clothfit.pictures import gif
from clothfit.scene.scene import load

Image = pytest.importorskip("PIL.Image", reason="Pillow is not installed; no animation is drawn")
ImageColor = pytest.importorskip("PIL.ImageColor")


def motion(frames=26, step=0.02):
    """A scene and a motion of it that is another one in every frame."""
    scene = load(document(colliders=[sphere(0.5)], windVel={"x": 3.0, "y": 0.0, "z": 4.0}))
    times = step * np.arange(frames)
    x = scene.cloths[0].positions + np.sin(np.linspace(0, 2, frames))[:, None, None] * [0.0, 1.5, 0.5]
    return scene, times, x


def read(*given, width=160):
    """Frames (F, height, width, 3) of the GIF of a motion, their durations, ms, and what else it says."""
    data = gif.animation(*given, width=width)
    with Image.open(io.BytesIO(data)) as image:
        frames, durations = [], []
        for index in range(image.n_frames):
            image.seek(index)
            durations.append(image.info["duration"])
            frames.append(np.array(image.convert("RGB")))
        return np.array(frames), durations, image.info


def test_it_loops_at_the_speed_of_the_clock_and_shows_a_cloth_that_moves():
    scene, times, x = motion()
    frames, durations, info = read(scene, times, x)
    assert info["loop"] == 0
    assert frames.shape[2] == 160
    assert read(scene, times[:1], x[:1], width=gif.GIF_WIDTH)[0].shape[2] == gif.GIF_WIDTH == 640
    assert len(frames) == 13  # of 26 frames at 20 ms every second, as two hundredths are too short for many viewers
    assert durations[:-1] == [40] * 12
    assert sum(durations) == pytest.approx(1000 * (times[24] + gif.LAST_FRAME_PAUSE), abs=5)  # to a hundredth
    filled = (np.abs(frames[0].astype(int) - ImageColor.getrgb(gif.GROUND)).max(axis=2) > 40).mean()
    assert 0.1 < filled < 0.9
    changes = [(np.abs(a.astype(int) - b) > 40).any(axis=2).mean() for a, b in pairwise(frames)]
    assert min(changes) > 1e-3  # more than the bar of the time, which is two pixels high


def test_the_target_is_green_and_what_is_unobserved_is_not_there():
    scene, times, x = motion(3)
    apart, nothing = x + [0.0, 2.0, 0.0], np.full_like(x, np.nan)
    (with_target, *_), _, _ = read(scene, times, x, apart)
    (without, *_), _, _ = read(scene, times, x, nothing)
    assert greens(with_target) > 20 * greens(without)  # the word "target" is green as well


def greens(frame):
    """The share of pixels that are clearly green."""
    red, green, blue = frame.astype(int).transpose(2, 0, 1)
    return (green > np.maximum(red, blue) + 15).mean()


@pytest.mark.parametrize(
    ("count", "step", "every"),
    [(500, 0.02, 4), (100, 0.02, 2), (3000, 0.01, 20), (11, 0.1, 1), (1, 0.02, 1)],  # 4: 10 s / 150 is above 3 steps
)
def test_frames_are_thinned_to_what_can_be_seen(count, step, every):
    film = gif.film(step * np.arange(count))
    assert film.frames == list(range(0, count, every))
    assert len(film.frames) == len(film.durations) <= gif.MOST_GIF_FRAMES + 1
    assert min(film.durations) >= 20
    assert film.speed == 1.0
    between = sum(film.durations[:-1])
    assert between == pytest.approx(1000 * step * film.frames[-1], abs=5)


def test_a_motion_too_short_to_be_seen_is_slowed_down_and_one_that_diverges_is_drawn_as_far_as_it_is_good():
    film = gif.film(1e-4 * np.arange(101))
    assert film.speed == pytest.approx(0.01 / gif.SLOWED_TO)
    assert sum(film.durations[:-1]) == pytest.approx(1000 * gif.SLOWED_TO, abs=50)
    scene, times, x = motion()
    wild = x.copy()
    wild[13:] *= 1e9
    assert read(scene, times, wild)[1] == read(scene, times[:13], x[:13])[1]


def test_several_cloths_are_drawn():
    scene = load(document(cloth(), cloth(vertPos=[{"x": i % 4 + 5.0, "y": 0.0, "z": i // 4} for i in range(12)])))
    x = np.concatenate([one.positions for one in scene.cloths])[None]
    (frame,), _, _ = read(scene, np.zeros(1), x)
    red, _, blue = frame.astype(int).transpose(2, 0, 1)
    assert (blue > red + 30).mean() > 0.03
    assert (red > blue + 30).mean() > 0.03
