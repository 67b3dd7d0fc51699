"""What may be done to a file without changing what it says, and what must not pass unnoticed."""

import os
from collections import Counter
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from neurosym_jax.data import ReadOptions, make_tracks, read_any, windows_from
from neurosym_jax.data.formats import FORMATS
from neurosym_jax.errors import InputError

KINDS = tuple(name for name in FORMATS if name != "bag")
ALL = (*KINDS, "frames")
"""Formats of text, and tables with frame numbers."""
TABLES = ("columns", "frames")
BARE = ("text", "obsmat", "cliff")
HEADS = {
    "tracklets": "Time,x,y,ag_id,tracklet_id",
    "columns": "time;person;x;y",
    "frames": "frame,id,x,y",
}

pytestmark = pytest.mark.filterwarnings("ignore::neurosym_jax.errors.InputWarning")
# The same examples wherever many builds are compared, others at every run elsewhere.
FEW = settings(max_examples=4, deadline=None, derandomize="CI" in os.environ)


class Walk:
    """People who walk, step by step; `rows [R, 6]` are step, person, x, y, vx, vy."""

    def __init__(self, seed: int, people: int = 3, steps: int = 18):
        rng = np.random.default_rng(seed)
        angle, pace = rng.uniform(-3, 3, people), rng.uniform(0.8, 1.6, people)
        angle[0] = 1.5  # Where all headings are small, speed and heading are much like vx and vy.
        velocity = pace[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        start = rng.uniform(-8, 8, (people, 2))
        rows = []
        for step in range(steps):
            for person in range(people):
                if person and rng.random() < 0.1:
                    continue
                place = start[person] + 0.4 * step * velocity[person] + rng.normal(0, 0.01, 2)
                rows.append([step, 3 + 2 * person, *place.round(3), *velocity[person].round(3)])
        self.rows = np.array(rows)


def written(kind, rows, *, first=0, times=10, start=0.0, scale=1.0, name: Any = str):
    """The lines of a file that says `rows`, its head apart; a metre has `scale` of its unit."""
    if kind == "qtm":
        return written_qtm(rows, first, start)
    lines = []
    for step, person, x, y, vx, vy in rows.tolist():
        frame, time = first + times * int(step), repr(round(start + 0.4 * step, 6))
        who, x, y = name(int(person)), float(x * scale), float(y * scale)
        speed, heading = float(np.hypot(vx, vy)), float(np.arctan2(vy, vx))
        form = {
            "text": f"{frame}\t{who}\t{x!r}\t{y!r}",
            "obsmat": f"{frame} {who} {x!r} 0 {y!r} {vx!r} 0 {vy!r}",
            "cliff": f"{time},{who},{x!r},{y!r},{speed!r},{heading!r}",
            "tracklets": f"{time},{x!r},{y!r},Helmet_{who},{int(person)}.0",
            "trajnet": f'{{"track": {{"f": {frame}, "p": {who}, "x": {x!r}, "y": {y!r}}}}}',
            "columns": f"{time};{who};{x!r};{y!r}",
            "frames": f"{frame},{who},{x!r},{y!r}",
        }
        lines.append(form[kind])
    return ([HEADS[kind]] if kind in HEADS else []), lines


def written_qtm(rows, first, start):
    people = sorted({int(row[1]) for row in rows})
    at = {(int(row[0]), int(row[1])): (1000 * row[2], 1000 * row[3], 1700.0) for row in rows}
    header = [f"Helmet_{person} {axis}" for person in people for axis in "XYZ"]
    lines = []
    for step in sorted({int(row[0]) for row in rows}):
        fields = [at.get((step, person), (0.0, 0.0, 0.0)) for person in people]
        time = repr(round(start + 0.4 * step, 6))
        values = [repr(float(value)) for field in fields for value in field]
        lines.append("\t".join([str(first + step), time, *values]))
    return ["FREQUENCY\t100", "\t".join(["Frame", "Time", *header])], lines


def text_of(kind, head, lines):
    return "\n".join([*head, *lines]) + "\n"


@pytest.fixture(scope="session")
def scenes(tmp_path_factory):
    """Of a file's text its windows of 3 + 3 steps: how often each set of ways was gone."""
    path = tmp_path_factory.mktemp("metamorphic") / "walk.txt"

    def cut(text, **options):
        path.write_text(text)
        windows = windows_from(path, 3, 3, min_agents=1, read=ReadOptions(**options))
        ways = np.split(windows.position.round(6) + 0.0, windows.bounds[1:-1])
        return Counter(frozenset(way.tobytes() for way in together) for together in ways)

    return cut


CLOCKS = ({"first": 780, "times": 6, "start": 1.7e9}, {"first": -999, "times": 12, "start": -3.21})


@pytest.mark.parametrize("kind", ALL)
@FEW
@given(seed=st.integers(0, 999), order=st.randoms(use_true_random=False))
def test_what_says_the_same_gives_the_same(scenes, kind, seed, order):
    """Rows in another order, another clock, unit or names of people."""
    rows = Walk(seed).rows
    head, lines = written(kind, rows)
    before = scenes(text_of(kind, head, lines))
    for clock in CLOCKS:
        assert scenes(text_of(kind, *written(kind, rows, **clock))) == before
    if kind in (*TABLES, "text"):
        for unit, scale in (("cm", 100), ("mm", 1000), ("0.5", 2)):
            text = text_of(kind, *written(kind, rows, scale=scale))
            assert scenes(text, unit=unit) == before
    if kind in (*TABLES, *BARE):
        names = [lambda who: str(7 * who - 20)]
        names += [lambda who: f"p{who}"] * (kind == "columns")
        for name in names:
            assert scenes(text_of(kind, *written(kind, rows, name=name))) == before
    order.shuffle(lines)
    assert scenes(text_of(kind, head, lines)) == before
    with pytest.raises(InputError, match="repeats"):
        scenes(text_of(kind, head, [*lines, lines[0]]))


@pytest.mark.parametrize("seed", range(5))
def test_velocities_are_no_speed_and_heading(scenes, seed):
    """`frame id x y vx vy` and `... z vx vy vz` have as many numbers as other formats."""
    rows = Walk(seed).rows.tolist()
    six = "\n".join(f"{s:g} {p:g} {x} {y} {vx} {vy}" for s, p, x, y, vx, vy in rows)
    timed = "\n".join(f"{0.4 * s:.1f},{p:g},{x},{y},{vx},{vy}" for s, p, x, y, vx, vy in rows)
    eight = "\n".join(f"{s:g} {p:g} {x} {y} 0 {vx} {vy} 0" for s, p, x, y, vx, vy in rows)
    for text in (six, timed, eight):
        with pytest.raises(InputError, match="--columns"):
            scenes(text)
    truth = scenes("\n".join(f"{s:g} {p:g} {x} {y}" for s, p, x, y, *_ in rows))
    swapped = "\n".join(f"{p:g} {s:g} {x} {y}" for s, p, x, y, *_ in rows)
    assert scenes(six, columns=("frame=1", "id=2", "x=3", "y=4")) == truth
    assert scenes(swapped, columns=("frame=2", "id=1", "x=3", "y=4")) == truth


@pytest.mark.parametrize("kind", KINDS)
@FEW
@given(seed=st.integers(0, 999))
def test_what_is_written_is_read(kind, seed, tmp_path_factory):
    rows = Walk(seed).rows
    path = tmp_path_factory.mktemp("w") / "walk.txt"
    path.write_text("\ufeff" * (seed % 2) + text_of(kind, *written(kind, rows)))
    (tracks,) = read_any(path)
    truth = make_tracks("walk", 0.4 * rows[:, 0], rows[:, 1], rows[:, 2:4])
    assert tracks.recording == ("walk_1" if kind == "tracklets" else "walk")
    assert tracks.reading is not None
    assert (tracks.reading.format, tracks.reading.rows) == (kind, len(rows))
    assert_array_equal(tracks.id, truth.id)
    assert_allclose(tracks.stamp, truth.stamp, atol=1e-9)
    assert_allclose(tracks.position, truth.position, rtol=0, atol=1e-9)
