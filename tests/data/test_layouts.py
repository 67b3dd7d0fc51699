"""One recording in the layouts that people have: each says the same tracks, or asks for what does.

The layouts are drawn by Hypothesis from clocks, units, flags, orders, names and sentinels.
"""

import dataclasses
import json
import os
import re
import shlex
import sqlite3

import numpy as np
import polars as pl
import pytest
import tyro
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat
from scipy.spatial import KDTree

from neurosym_jax.data import ReadOptions, read_any
from neurosym_jax.data.recordings import recordings_in
from neurosym_jax.errors import InputError, InputWarning, spoken_as_flags
from studies.mistakes.crowd import CROWD, table

pytestmark = pytest.mark.filterwarnings("ignore::neurosym_jax.errors.InputWarning")
TRUTH = np.column_stack([CROWD.t, CROWD.x, CROWD.y])
MIDNIGHT = 86_395.0  # seconds of the day at which a clock begins


def says(tracks, rows=TRUTH, tolerance=1e-6):
    """Whether tracks have the rows [R, 3] of seconds, x and y, and no others, in any order."""
    points = np.column_stack([tracks.stamp - tracks.stamp.min(), tracks.position])
    rows = rows - [rows[:, 0].min(), 0, 0]
    far, _ = KDTree(rows).query(points)
    return len(points) == len(rows) and far.max() < tolerance


def read_as_told(path, options=()):
    """The recording, after pasting at most three of the commands that refusals print."""
    words = [*options]
    for _ in range(4):
        try:
            with spoken_as_flags():
                (tracks,) = read_any(path, tyro.cli(ReadOptions, args=words))
            return tracks
        except InputError as error:
            message = str(error)
        printed = re.search(r"say (--columns .*?)(?:, or | where |$)", message)
        assert printed, message
        words = [*options, *shlex.split(printed[1])]
    raise AssertionError("refused after three commands")


def clock_of(kind, seconds):
    """Texts of a clock, and the name of its column."""
    if kind == "frame":
        return "frame", (10 * CROWD.step).astype(str)
    if kind == "picture":
        return "file_name", [f"{10 * step:06}.jpg" for step in CROWD.step]
    if kind == "clock":
        seconds = (seconds + MIDNIGHT) % 86_400
        hours, rest = np.divmod(seconds, 3600)
        texts = zip(hours, *np.divmod(rest, 60))
        return "time", [f"{h:02.0f}:{m:02.0f}:{s:06.3f}" for h, m, s in texts]
    if kind == "date":
        return "time", [
            f"25/03/2024 12:{t // 60:02.0f}:{t % 60:06.3f}" for t in seconds
        ]
    if kind == "ms":
        return "t_ms", (1000 * seconds).round().astype(int).astype(str)
    return "time", seconds.astype(str)


FLAGS = {
    "none": None,
    "lost": ("tracked", "lost"),
    "track_state": ("confirmed", "deleted"),
    "visible": ("1", "0"),
    "is_predicted": ("False", "True"),
    "anything": ("seen", "hidden"),
}
SENTINELS = ("none", "0", "-9999", "nan", "")


@settings(
    max_examples=40,
    deadline=None,
    derandomize="CI" in os.environ,
)
@given(
    clock=st.sampled_from(["frame", "picture", "clock", "date", "ms", "seconds"]),
    flag=st.sampled_from(list(FLAGS)),
    unit=st.sampled_from([("", 1.0), (" [cm]", 0.01), ("_mm", 0.001)]),
    sentinel=st.sampled_from(SENTINELS),
    person=st.sampled_from(["id", "track_id", "user", "Person"]),
    is_named=st.booleans(),
    extras=st.lists(st.sampled_from(["label", "speed", "row"]), unique=True),
    mark=st.sampled_from([",", ";", "\t"]),
    order=st.permutations(range(4)),
    twice=st.booleans(),
)
def test_a_recording_says_the_same_in_forty_layouts(tmp_path_factory, **layout):
    path = tmp_path_factory.mktemp("layouts") / "mine.csv"
    rng = np.random.default_rng(0)
    size = len(CROWD.id)
    gone = rng.random(size) < 0.05
    lost = (rng.random(size) < 0.05) & ~gone
    suffix, metres = layout["unit"]
    name, times = clock_of(layout["clock"], CROWD.t)
    columns = {name: times, layout["person"]: CROWD.id.astype(str)}
    if layout["is_named"]:
        columns[layout["person"]] = [f"anna_{person}" for person in CROWD.id]
    for axis in "xy":
        values = (getattr(CROWD, axis) / metres).round(3).astype(str).astype(object)
        if layout["sentinel"] != "none":
            values[gone] = layout["sentinel"]
        columns[axis + suffix] = values
    columns = dict([*columns.items()][at] for at in layout["order"])
    if FLAGS[layout["flag"]]:
        columns[layout["flag"]] = np.where(lost, *FLAGS[layout["flag"]][::-1])
    others = {
        "label": [f"ID{at}" for at in range(size)],
        "speed": rng.random(size).round(3).astype(str),
        "row": [f"r{at}" for at in range(size)],
    }
    columns |= {name: others[name] for name in layout["extras"]}
    lines = list(map(layout["mark"].join, zip(*columns.values())))
    lines += lines[:1] * layout["twice"]
    path.write_text("\n".join([layout["mark"].join(columns), *lines, ""]))

    tracks = read_as_told(path)
    seen = np.ones(size, bool)
    if layout["sentinel"] != "none":
        seen &= ~gone
    if layout["flag"] != "none":
        seen &= ~lost
    assert says(tracks, TRUTH[seen], 2e-3)
    assert len(np.unique(tracks.id)) == len(np.unique(CROWD.id[seen]))
    counted = sum(int(line.split()[0]) for line in tracks.reading.left_out)
    assert counted == size - seen.sum() + layout["twice"]
    assert len(tracks.id) == tracks.reading.rows


def grid():
    """[T, N, 2] positions, NaN where nobody is."""
    people = np.unique(CROWD.id)
    array = np.full((CROWD.step.max() + 1, len(people), 2), np.nan)
    array[CROWD.step, np.searchsorted(people, CROWD.id)] = TRUTH[:, 1:]
    return array


ROWS = np.column_stack([10 * CROWD.step, CROWD.id, CROWD.x, CROWD.y])


def test_arrays_are_recordings(tmp_path):
    """Rows, columns and positions, in memory and in files, with time along either axis."""
    columns = dict(zip(("frame", "id", "x", "y"), ROWS.T))
    for data in (ROWS, columns, grid(), grid().swapaxes(0, 1)):
        (tracks,) = recordings_in(data)
        assert says(tracks)
    np.save(tmp_path / "a.npy", grid())
    np.savez(tmp_path / "b.npz", **columns)
    savemat(tmp_path / "c.mat", columns)
    savemat(tmp_path / "d.mat", {"positions": grid(), "rate": 2.5})
    for name in ("a.npy", "b.npz", "c.mat", "d.mat"):
        (tracks,) = read_any(tmp_path / name)
        assert says(tracks)
    with pytest.raises(InputError, match="which axis is time"):
        read_any(np.random.default_rng(0).normal(size=(20, 20, 2)))
    with pytest.raises(InputError, match=r"\[7\] .* is no recording.*make_tracks"):
        read_any(np.zeros(7))


def test_json_by_name_and_of_coco(tmp_path):
    path = tmp_path / "a.json"
    people = {
        f"ped_{person}": {
            key: getattr(CROWD, key)[CROWD.id == person].tolist() for key in "txy"
        }
        for person in np.unique(CROWD.id)
    }
    path.write_text(json.dumps(people))
    assert says(read_as_told(path))
    boxes = [
        {
            "image_id": int(step),
            "track_id": int(person),
            "category_id": 1,
            "bbox": [x / 0.02 - 15, -y / 0.02 - 70, 30, 70],
        }
        for step, person, x, y in zip(CROWD.step, CROWD.id, CROWD.x, CROWD.y)
    ]
    images = [{"id": int(step), "frame_id": 10 * int(step)} for step in set(CROWD.step)]
    categories = [{"id": 1, "name": "pedestrian"}]
    path.write_text(
        json.dumps({"images": images, "annotations": boxes, "categories": categories})
    )
    tracks = read_as_told(path, ["--unit", "0.02", "--fps", "25"])
    assert says(tracks)


def test_a_table_among_several_is_chosen_by_its_name(tmp_path):
    path = tmp_path / "a.sqlite"
    with sqlite3.connect(path) as base:
        for name, shift in (("run_1", 0.0), ("run_2", 5.0)):
            base.execute(f"create table {name} (t real, id int, x real, y real)")
            rows = np.column_stack([CROWD.t, CROWD.id, CROWD.x + shift, CROWD.y])
            base.executemany(f"insert into {name} values (?, ?, ?, ?)", rows.tolist())
    assert says(read_as_told(path))
    (tracks,) = read_any(path, ReadOptions(columns=("table=run_2",)))
    assert says(tracks, np.add(TRUTH, [0, 5, 0]))


def test_a_pickle_is_code(tmp_path):
    path = tmp_path / "a.pkl"
    pytest.importorskip("pandas")
    pl.DataFrame({"t": CROWD.t}).to_pandas().to_pickle(path)
    with pytest.raises(InputError, match=r"may run any code.*read_pickle"):
        read_any(path)


def test_a_folder_says_which_files_have_no_people(tmp_path):
    (tmp_path / "people.csv").write_text(table(label=["ped"] * len(CROWD.id)))
    (tmp_path / "cars.csv").write_text(table(label=["car"] * len(CROWD.id)))
    with pytest.warns(InputWarning, match=r"cars\.csv: left out: it has no people"):
        (tracks,) = recordings_in(tmp_path)
    assert tracks.recording == "people"


def test_words_that_nobody_knows_are_asked_for(tmp_path):
    path = tmp_path / "a.csv"
    states = np.where(CROWD.step % 20 == 9, "wobbly", "tracked")
    path.write_text(table(lost=states))
    with pytest.raises(InputError, match=r"'lost' has wobbly: .*lost=none"):
        read_any(path)
    read = ReadOptions(columns=("label=lost",), keep=("tracked",))
    (tracks,) = read_any(path, read)
    assert says(tracks, TRUTH[states == "tracked"])
    (tracks,) = read_any(path, ReadOptions(columns=("lost=none",)))
    assert says(tracks)


def test_what_people_share_by_right_is_a_place(tmp_path):
    """A door where all begin, a seat, and a person who stands at 0, 0."""
    path = tmp_path / "a.csv"
    first = np.searchsorted(CROWD.id, CROWD.id)
    is_near_door = np.arange(len(first)) == first
    x = np.where(CROWD.id == 5, 0.0, np.where(is_near_door, CROWD.x.min(), CROWD.x))
    y = np.where(CROWD.id == 5, 0.0, CROWD.y)
    path.write_text(table(CROWD.but(x=x, y=y)))
    (tracks,) = read_any(path)
    assert len(tracks.id) == len(CROWD.id)


def test_the_middle_and_the_corner_of_a_box_are_told_apart(tmp_path):
    path, size = tmp_path / "a.csv", len(CROWD.id)
    np.savetxt(tmp_path / "h.txt", np.diag([0.02, 0.02, 1]))
    wide, high = [30] * size, 60 + 10 * np.sin(CROWD.step)
    bottom, middle = CROWD.y / 0.02, CROWD.x / 0.02
    for x, y, answer in (
        (middle - 15, bottom - high, r"left=x top=y width=w height=h"),
        (middle, bottom - high / 2, r"x=x y=y width=w height=h"),
    ):
        path.write_text(table(CROWD.but(x=x, y=y), w=wide, h=high))
        words = ["--homography", str(tmp_path / "h.txt")]
        with pytest.raises(InputError, match=answer), spoken_as_flags():
            read_any(path, tyro.cli(ReadOptions, args=words))
        words += ["--columns", *answer.split()]
        (tracks,) = read_any(path, tyro.cli(ReadOptions, args=words))
        assert says(tracks)


def test_degrees_are_metres_about_their_middle(tmp_path):
    path = tmp_path / "a.csv"
    scale = np.radians(1) * 6_371_008.8
    lon = 13.4 + CROWD.x / scale / np.cos(np.radians(52.5))
    path.write_text(
        table(CROWD.but(x=lon, y=52.5 + CROWD.y / scale)).replace("x,y", "lon,lat", 1)
    )
    tracks = read_as_told(path)
    tracks = dataclasses.replace(
        tracks, position=tracks.position - tracks.position.mean(0)
    )
    centred = TRUTH - [0, CROWD.x.mean(), CROWD.y.mean()]
    assert says(tracks, centred, 2e-3)
    assert "metres east and north" in tracks.reading.notes[0]
