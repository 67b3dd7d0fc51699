"""What may be done to a file without changing what it says, and what must not pass unnoticed."""

import itertools
import os
from collections import Counter
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from neurosym_jax.data import ReadOptions, make_tracks, windows_from
from neurosym_jax.errors import InputError

KINDS = ("text", "columns", "obsmat", "qtm", "tracklets", "cliff", "trajnet")
ALL = (*KINDS, "frames")
"""Formats of text, and tables with frame numbers."""
TABLES = ("columns", "frames")
BARE = ("text", "obsmat", "cliff")
FORMS = (
    *("{0:g} {1:g} {2} {3}", "{1:g} {0:g} {2} {3}", "{0:g} {1:g} {2} {3} {4} {5}"),
    *("{6:.1f},{1:g},{2},{3},{4},{5}", "{0:g} {1:g} {2} {3} 0 {4} {5} 0"),
)
"""Of rows and their time: right, with frame and id swapped, and with velocities."""
HEADS = {
    "tracklets": "Time,x,y,ag_id,tracklet_id",
    "columns": "time;person;x;y",
    "frames": "frame,id,x,y",
}

pytestmark = pytest.mark.filterwarnings("ignore::neurosym_jax.errors.InputWarning")
# The same examples wherever many builds are compared, others at every run elsewhere.
FEW = settings(max_examples=4, deadline=None, derandomize="CI" in os.environ)


def walk(seed: int, people: int = 3, steps: int = 18) -> np.ndarray:
    """People who walk, step by step: rows [R, 6] of step, person, x, y, vx, vy."""
    rng = np.random.default_rng(seed)
    angle, pace = rng.uniform(-3, 3, people), rng.uniform(0.8, 1.6, people)
    # Where all headings are small, speed and heading are much like vx and vy.
    angle[0] = 1.5
    velocity = pace[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    step, person = np.divmod(np.arange(steps * people), people)
    place = (
        rng.uniform(-8, 8, (people, 2))[person] + 0.4 * step[:, None] * velocity[person]
    )
    place += rng.normal(0, 0.01, place.shape)
    rows = np.column_stack(
        [step, 3 + 2 * person, place.round(3), velocity[person].round(3)]
    )
    return rows[(person == 0) | (rng.random(len(rows)) > 0.1)]


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
    at = {
        (int(row[0]), int(row[1])): (1000 * row[2], 1000 * row[3], 1700.0)
        for row in rows
    }
    header = [
        f"Helmet_{person} {axis}" for person, axis in itertools.product(people, "XYZ")
    ]
    lines = []
    for step in sorted({int(row[0]) for row in rows}):
        fields = [at.get((step, person), (0.0, 0.0, 0.0)) for person in people]
        time = repr(round(start + 0.4 * step, 6))
        values = [repr(float(value)) for value in itertools.chain(*fields)]
        lines.append("\t".join([str(first + step), time, *values]))
    return ["FREQUENCY\t100", "\t".join(["Frame", "Time", *header])], lines


def text_of(head, lines):
    return "\n".join([*head, *lines]) + "\n"


@pytest.fixture(scope="session")
def read(tmp_path_factory):
    """Reads a file of this text as windows of 3 + 3 steps."""
    path = tmp_path_factory.mktemp("metamorphic") / "walk.txt"

    def cut(text, **options):
        path.write_text(text)
        return windows_from(path, 3, 3, min_agents=1, read=ReadOptions(**options))

    return cut


def ways(windows):
    """How often each set of ways is gone together, whatever the ids, clock and order."""
    windows = np.split(windows.position.round(6) + 0.0, windows.bounds[1:-1])
    scenes = Counter()
    for together in windows:
        scenes[frozenset(way.tobytes() for way in together)] += 1
    return scenes


CLOCKS = (
    {"first": 780, "times": 6, "start": 1.7e9},
    {"first": -999, "times": 12, "start": -3.21},
)


@pytest.mark.parametrize("kind", ALL)
@FEW
@given(seed=st.integers(0, 999), order=st.randoms(use_true_random=False))
def test_what_is_written_is_read_whatever_its_order_clock_unit_and_names(
    read, kind, seed, order
):
    rows = walk(seed)
    tracks = make_tracks("walk", 0.4 * rows[:, 0], rows[:, 1], rows[:, 2:4])
    truth = windows_from(tracks, 3, 3, min_agents=1)
    head, lines = written(kind, rows)
    windows = read(text_of(head, lines))
    assert set(windows.agent) == set(truth.agent)
    (reading,) = windows.reading
    assert reading.recording == ("walk_1" if kind == "tracklets" else "walk")
    assert (reading.format, reading.rows) == (
        "columns" if kind in TABLES else kind,
        len(rows),
    )

    def same(text, **options):
        assert ways(read(text, **options)) == ways(truth)

    same(text_of(head, lines))
    for clock in CLOCKS:
        same(text_of(*written(kind, rows, **clock)))
    if kind in (*TABLES, "text"):
        for unit, scale in (("cm", 100), ("mm", 1000), ("0.5", 2)):
            same(text_of(*written(kind, rows, scale=scale)), unit=unit)
    if kind in (*TABLES, *BARE):
        same(text_of(*written(kind, rows, name=lambda who: str(7 * who - 20))))
    if kind == "columns":
        same(text_of(*written(kind, rows, name=lambda who: f"p{who}")))
    order.shuffle(lines)
    same(text_of(head, lines))
    same(text_of(head, [*lines, lines[0]]))
    if kind != "qtm":
        _, moved = written(kind, np.add(rows[:1], [0, 0, 5, 0, 0, 0]))
        with pytest.raises(InputError, match="repeats"):
            read(text_of(head, [*lines, *moved]))


@pytest.mark.slow
def test_velocities_are_no_speed_and_heading(read):
    """`frame id x y vx vy` and `... z vx vy vz` have as many numbers as other formats."""
    for seed in range(5):
        rows = walk(seed).tolist()
        texts = []
        for form in FORMS:
            texts.append("\n".join(form.format(*row, 0.4 * row[0]) for row in rows))
        plain, swapped, six, timed, eight = texts
        for text in (six, timed, eight):
            with pytest.raises(InputError, match="columns="):
                read(text)
        for text, frame, who in ((six, 1, 2), (swapped, 2, 1)):
            columns = (f"frame={frame}", f"id={who}", "x=3", "y=4")
            assert ways(read(text, columns=columns)) == ways(read(plain))
