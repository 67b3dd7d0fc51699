"""Animations: real files, with a picture of each step."""

import shutil
import subprocess
from pathlib import Path

import matplotlib.colors
import numpy as np
import pytest
from PIL import Image

from neurosym_jax.commands.animate import run
from neurosym_jax.errors import InputError
from neurosym_jax.plotting import PALETTE, Moment, plot_animation, save_animation

SGAN = Path("sgan_zara1_8")


@pytest.fixture
def recording(tmp_path):
    """Three people who walk along x; the last one comes after ten steps, and a gap later."""
    rows = []
    for person in range(3):
        for step in range(10 * (person == 2), 30):
            if step not in (20, 21, 22, 23, 24):
                rows.append((step, person, 0.5 * step, 2.0 * person))
    path = tmp_path / "walk.txt"
    np.savetxt(path, sorted(rows), fmt="%g")
    return path


def test_a_gif_has_a_picture_of_each_step_at_its_speed(recording, tmp_path, capsys):
    out = tmp_path / "a" / "walk.gif"
    run(recording, model=SGAN, pictures=4, draws=3, out=out)
    with Image.open(out) as image:
        assert image.n_frames == 4
        assert image.info["duration"] == 400
    assert "4 steps of 0.4 s" in capsys.readouterr().out


def test_it_ends_where_the_recording_has_a_gap(recording, tmp_path, capsys):
    options = {"model": SGAN, "draws": 2, "out": tmp_path / "walk.gif"}
    run(recording, window=8, **options)
    assert "4 steps" in capsys.readouterr().out


def test_each_person_has_a_colour_and_the_picture_shows_everybody(tmp_path):
    people = np.array([3, 8])
    observed = np.cumsum(np.full((2, 8, 2), 0.4), axis=1)
    observed[1, :, 0] += 5
    futures = observed[None, :, -1:] + np.linspace(0, 1, 4)[:, None] * np.ones(2)
    moments = [Moment(people, observed, futures), Moment(people[:1], *first(observed))]
    animation = plot_animation(moments, title="two, then one")
    path = save_animation(animation, tmp_path / "a.gif", 0.2)
    with Image.open(path) as image:
        assert image.n_frames == 2
        assert image.info["duration"] == 200
        colours = [image_colours(image, number) for number in range(2)]
    assert len(colours[0] - colours[1]) > 0


def test_people_of_a_crowd_keep_their_colours_in_a_gif(tmp_path):
    """Pillow's own palette, of many blends, has brown for the dot of an orange person."""
    number = len(PALETTE)
    rng = np.random.default_rng(0)
    observed = np.cumsum(rng.normal(0.4, 0.1, (number, 8, 2)), axis=1)
    observed[:, :, 1] += 2 * np.arange(number)[:, None]
    steps = np.cumsum(rng.normal(0.4, 0.5, (40, number, 12, 2)), axis=2)
    moment = Moment(np.arange(number), observed, observed[:, None, -1] + steps)
    path = save_animation(plot_animation([moment] * 2), tmp_path / "a.gif", 0.4)
    with Image.open(path) as image:
        dots = np.asarray(image.convert("RGB")).reshape(-1, 3)
    for colour in map(matplotlib.colors.to_rgb, PALETTE):
        assert (dots == np.round(255 * np.array(colour))).all(axis=1).sum() > 10


def test_most_of_what_people_may_do_is_within_the_picture(tmp_path):
    """The first page's animation cut every second future off."""
    observed = np.zeros((1, 8, 2))
    steps = np.arange(1, 13)[:, None]
    headings = np.linspace(0, 2 * np.pi, 20)
    ways = np.stack([np.cos(headings), np.sin(headings)], axis=1)
    futures = 0.5 * ways[:, None, None] * steps
    animation = plot_animation([Moment(np.array([1]), observed, futures)])
    save_animation(animation, tmp_path / "a.gif", 0.4)
    (axes,) = animation._fig.axes
    for axis, limits in enumerate((axes.get_xlim(), axes.get_ylim())):
        positions = futures[..., axis]
        shown = (limits[0] < positions) & (positions < limits[1])
        assert shown.mean() > 0.94


def first(observed):
    futures = np.broadcast_to(observed[None, :1, -1:], (3, 1, 2, 2))
    return observed[:1], futures


def image_colours(image, number):
    """Saturated colours of a picture that many dots have."""
    image.seek(number)
    dots = np.asarray(image.convert("RGB")).reshape(-1, 3).astype(int)
    saturated = dots[np.ptp(dots, axis=1) > 100] // 32
    colours, counts = np.unique(saturated, axis=0, return_counts=True)
    return {tuple(colour) for colour in colours[counts > 20].tolist()}


def test_an_mp4_is_a_film_or_says_what_is_missing(tmp_path):
    moment = Moment(np.array([1]), np.zeros((1, 8, 2)), np.ones((2, 1, 8, 2)))
    path = tmp_path / "a.mp4"
    if shutil.which("ffmpeg") is None:
        with pytest.raises(InputError, match=r"\.mp4 needs the program ffmpeg"):
            save_animation(plot_animation([moment, moment]), path, 0.4)
        return
    save_animation(plot_animation([moment, moment]), path, 0.4)
    told = subprocess.run(["ffmpeg", "-i", path], capture_output=True, text=True)
    assert "2.50 fps" in told.stderr or "2.5 fps" in told.stderr
