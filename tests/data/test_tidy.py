"""One recording in tables of other shapes, and as GeoJSON: the same tracks from each."""

import csv
import datetime
import json

import numpy as np
import pytest

from neurosym_jax.data.recordings import read_any
from neurosym_jax.data.tables import ReadOptions
from neurosym_jax.errors import InputError

START = 1_714_560_000  # seconds of a Unix clock
STEPS, PEOPLE, PERIOD = 20, 3, 0.4
EARTH = 6_371_008.8

rng = np.random.default_rng(0)
HEADING = rng.uniform(0, 6, PEOPLE) + rng.normal(0, 0.1, (STEPS, PEOPLE)).cumsum(axis=0)
WALK = 0.5 * np.stack([np.cos(HEADING), np.sin(HEADING)], axis=-1).cumsum(axis=0)
WALK = (WALK + rng.uniform(-5, 5, (PEOPLE, 2))).round(3)
"""[STEPS, PEOPLE, 2] metres."""


def rows():
    """(step, person, x, y), each in turn."""
    for step in range(STEPS):
        for person in range(PEOPLE):
            yield step, person, *WALK[step, person].tolist()


def written(path, head, lines):
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(head)
        table.writerows(lines)
    return path


def degrees(x, y):
    """The longitude and latitude of a place in metres from 8.5, 48.1."""
    north = np.degrees(y / EARTH)
    east = np.degrees(x / EARTH / np.cos(np.radians(48.1)))
    return 8.5 + east, 48.1 + north


def is_walk(tracks):
    """Whether a recording is `WALK`, wherever it begins."""
    order = np.lexsort((tracks.id, tracks.stamp))
    walk = tracks.position[order].reshape(STEPS, PEOPLE, 2)
    steps = np.diff(np.unique(tracks.stamp))
    same = np.allclose(walk - walk[0, 0], WALK - WALK[0, 0], atol=2e-3)
    return same and np.allclose(steps, PERIOD, atol=1e-5)


@pytest.mark.parametrize(("unit", "scale"), [(" sec", 1), ("s", 1), (" ms", 1000)])
@pytest.mark.parametrize(("metre", "size"), [("", 1), (" m", 1), ("cm", 100)])
def test_units_in_cells(tmp_path, unit, scale, metre, size):
    """As MATLAB writes durations. A letter of an id is no unit."""
    lines = []
    for t, who, x, y in rows():
        places = [f"{size * value:.4f}{metre}" for value in (x, y)]
        lines.append((f"{scale * PERIOD * t:.6g}{unit}", f"{who} m", *places))
    path = written(tmp_path / "a.csv", ["time", "id", "x", "y"], lines)
    (tracks,) = read_any(path)
    assert is_walk(tracks)
    assert set(tracks.names) == {"0 m", "1 m", "2 m"}


def test_cells_of_two_units_are_refused(tmp_path):
    lines = [
        (f"{PERIOD * t:.1f} {'s' if t else 'ms'}", who, x, y) for t, who, x, y in rows()
    ]
    path = written(tmp_path / "a.csv", ["time", "id", "x", "y"], lines)
    with pytest.raises(InputError, match=r"row 2: time is not a number: '0\.0 ms'"):
        read_any(path)
    lines = [(f"{PERIOD * t:.1f} sec", who, x, y) for t, who, x, y in rows()]
    path = written(tmp_path / "b.csv", ["time [ms]", "id", "x", "y"], lines)
    with pytest.raises(InputError, match=r"is not a number: '0\.0 sec'"):
        read_any(path)


@pytest.mark.parametrize("start", ["11:59:57", "23:59:57", "00:59:57", "12:59:57"])
@pytest.mark.parametrize("date", ["", "%m/%d/%Y "])
@pytest.mark.parametrize("half", [" %p", "%p"])
def test_twelve_hours_of_a_clock(tmp_path, start, date, half):
    moment = datetime.datetime.fromisoformat(f"2024-05-21 {start}")
    lines = []
    for t, who, x, y in rows():
        now = moment + datetime.timedelta(seconds=PERIOD * t)
        text = now.strftime(f"{date}%I:%M:%S.{now.microsecond // 1000:03d}{half}")
        lines.append((text, who, x, y))
    path = written(tmp_path / "a.csv", ["time", "id", "x", "y"], lines)
    (tracks,) = read_any(path)
    assert is_walk(tracks)
    seconds = 3600 * moment.hour + 60 * moment.minute + moment.second
    assert tracks.stamp.min() % 86_400 == pytest.approx(seconds)


@pytest.mark.parametrize(
    ("name", "form"),
    [
        ("position", "({}, {})"),
        ("position", "[{} {}]"),
        ("where", "[{}, {}, 0.0]"),
        ("centre", "( {} ; {} )"),
        ("geometry", "POINT ({} {})"),
        ("geometry", "POINT Z ({} {} 0)"),
    ],
)
def test_points_in_cells(tmp_path, name, form):
    lines = [(PERIOD * t, who, form.format(x, y)) for t, who, x, y in rows()]
    path = written(tmp_path / "a.csv", ["time", "id", name], lines)
    (tracks,) = read_any(path)
    assert is_walk(tracks)
    assert tracks.reading.notes == (f"points are in the cells of {name!r}",)


def test_points_in_two_columns_of_cells_are_told_apart_or_asked_for(tmp_path):
    lines = [
        (PERIOD * t, who, f"({x}, {y})", f"({y}, {-x})", "(a)")
        for t, who, x, y in rows()
    ]
    head = ["time", "id", "center", "velocity", "text"]
    (tracks,) = read_any(written(tmp_path / "a.csv", head, lines))
    assert is_walk(tracks)
    head[2:4] = "one", "other"
    with pytest.raises(InputError, match=r"which column is x, y\? .* 'x=one\.x'"):
        read_any(written(tmp_path / "a.csv", head, lines))
    columns = ("x=one.x", "y=one.y")
    (tracks,) = read_any(tmp_path / "a.csv", ReadOptions(columns=columns))
    assert is_walk(tracks)


def test_points_in_degrees(tmp_path):
    lines = []
    for t, who, x, y in rows():
        east, north = degrees(x, y)
        lines.append((PERIOD * t, who, f"POINT ({east:.9f} {north:.9f})"))
    (tracks,) = read_any(written(tmp_path / "a.csv", ["time", "id", "wkt"], lines))
    assert is_walk(tracks)


def test_a_point_that_is_missing_is_a_row_without_a_position(tmp_path):
    lines = [(PERIOD * t, who, f"({x}, {y})") for t, who, x, y in rows()]
    lines += [(PERIOD * t, 9, text) for t, text in enumerate(["", "(nan, nan)"])]
    path = written(tmp_path / "a.csv", ["time", "id", "xy"], lines)
    (tracks,) = read_any(path)
    assert is_walk(tracks)
    assert tracks.reading.left_out == ("2 rows without a position",)


def test_a_first_row_without_a_point(tmp_path):
    lines = [(0, 9, "")]
    lines += [(PERIOD * t, who, f"({x}, {y})") for t, who, x, y in rows()]
    (tracks,) = read_any(written(tmp_path / "a.csv", ["time", "id", "xy"], lines))
    assert is_walk(tracks)


def test_a_cell_that_is_no_point_is_named_unless_positions_stand_elsewhere(tmp_path):
    lines = [(PERIOD * t, who, f"({x}, {y})", x, y) for t, who, x, y in rows()]
    lines[7] = (*lines[7][:2], "lost", *lines[7][3:])
    head = ["time", "id", "goal", "x", "y"]
    (tracks,) = read_any(written(tmp_path / "a.csv", head, lines))
    assert is_walk(tracks)
    path = written(tmp_path / "a.csv", head[:3], [line[:3] for line in lines])
    with pytest.raises(InputError, match="row 9: goal is not a point: 'lost'"):
        read_any(path)


def test_a_time_of_which_a_part_is_missing_is_named(tmp_path):
    lines = [(START + t, 5, who, x, y) for t, who, x, y in rows()]
    lines[7] = (lines[7][0], "", *lines[7][2:])
    path = written(tmp_path / "a.csv", ["secs", "nsecs", "id", "x", "y"], lines)
    with pytest.raises(InputError, match=r"row 9: time \[s\] is not a number"):
        read_any(path)


def test_a_day_beside_a_time_of_day(tmp_path):
    """Of two days: each has people of its own, who may have the other's numbers."""
    for again in (0, 50):
        lines = []
        for day in (24, 25):
            for t, who, x, y in rows():
                clock = f"11:59:{50 + PERIOD * t:04.1f}"
                lines.append((f"2024-03-{day}", clock, who + again * (day - 24), x, y))
        path = written(tmp_path / "a.csv", ["Date", "Time", "id", "x", "y"], lines)
        (tracks,) = read_any(path)
        first = tracks.stamp < tracks.stamp.min() + 86_400
        assert is_walk(tracks.take(first))
        assert is_walk(tracks.take(~first))
        assert tracks.reading.notes == ("times are Date and Time",)


@pytest.mark.parametrize("day", ["03/04/2024", "20240403", "Monday"])
def test_one_day_need_not_be_told_from_a_month(tmp_path, day):
    lines = []
    for t, who, x, y in rows():
        lines.append((day, f"11:59:{50 + PERIOD * t:04.1f}", who, x, y))
    path = written(tmp_path / "a.csv", ["Date", "Time", "id", "x", "y"], lines)
    (tracks,) = read_any(path)
    assert is_walk(tracks)


@pytest.mark.parametrize(
    ("seconds", "rest", "digits"),
    [
        ("secs", "nsecs", 9),
        ("header.stamp.secs", "header.stamp.nsecs", 9),
        ("stamp_sec", "stamp_nanosec", 9),
        ("tv_sec", "tv_usec", 6),
        ("seconds", "milliseconds", 3),
    ],
)
def test_seconds_and_the_rest_of_a_second(tmp_path, seconds, rest, digits):
    lines = []
    for t, who, x, y in rows():
        whole, part = divmod(round(PERIOD * t * 10**digits), 10**digits)
        lines.append((START + whole, part, who, x, y))
    path = written(tmp_path / "a.csv", [seconds, rest, "id", "x", "y"], lines)
    (tracks,) = read_any(path)
    assert is_walk(tracks)
    assert f"times are {seconds} and {rest}" in tracks.reading.notes


def test_other_seconds_and_milliseconds_are_no_two_parts(tmp_path):
    """A delay; and the same time in both units, of which one is asked for."""
    lines = [(PERIOD * t, 3, who, x, y) for t, who, x, y in rows()]
    path = written(tmp_path / "a.csv", ["secs", "delay_ms", "id", "x", "y"], lines)
    (tracks,) = read_any(path)
    assert is_walk(tracks)
    lines = [(PERIOD * t, 400 * t, who, x, y) for t, who, x, y in rows()]
    path = written(tmp_path / "a.csv", ["t_s", "t_ms", "id", "x", "y"], lines)
    with pytest.raises(InputError, match=r"'time=t_s', .* or .*'time=t_ms'"):
        read_any(path)


def test_rostopic(tmp_path):
    """`rostopic echo -p`: nanoseconds, and names with dots."""
    lines = []
    for t, who, x, y in rows():
        stamp = START * 10**9 + t * 400_000_000
        lines.append((stamp + 12_000_000, t, stamp, "map", who, x, y, 0.0))
    head = ["%time", "field.header.seq", "field.header.stamp", "field.header.frame_id"]
    head += ["field.id", *(f"field.pose.position.{axis}" for axis in "xyz")]
    (tracks,) = read_any(written(tmp_path / "a.csv", head, lines))
    assert is_walk(tracks)
    assert tracks.reading.columns[0] == "time=time [ns]"


@pytest.mark.parametrize(
    ("head", "scale"),
    [
        ("x{0} y{0}", 1),
        ("x{0}_cm y{0}_cm", 100),
        ("x_{0}_cm y_{0}_cm", 100),
        ("person{0}_x person{0}_y", 1),
        ("field.people{0}.position.x field.people{0}.position.y", 1),
    ],
)
@pytest.mark.parametrize("name", ["", "id{0}", "field.people{0}.name"])
def test_people_side_by_side(tmp_path, head, scale, name):
    """Where a place has ids of its own, two people who change places stay who they are."""
    names = ["time"]
    for place in range(PEOPLE):
        names += f"{name} {head}".format(place).split()
    lines = []
    for step in range(STEPS):
        line = [PERIOD * step]
        for place in range(PEOPLE):
            person = place
            if name and step > 9:
                person = PEOPLE - 1 - place
            ids = [f"p{person}"] if name else []
            line += [*ids, *(scale * WALK[step, person]).round(6).tolist()]
        lines.append(line)
    (tracks,) = read_any(written(tmp_path / "a.csv", names, lines))
    assert is_walk(tracks)
    assert "columns of 3 people side by side" in tracks.reading.notes
    assert not tracks.reading.warnings


def point(xy, **properties):
    geometry = {"type": "Point", "coordinates": xy}
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def line(points, properties, **others):
    geometry = {"type": "LineString", "coordinates": points}
    return {"type": "Feature", "geometry": geometry, "properties": properties, **others}


def collection(features, **others):
    return {"type": "FeatureCollection", "features": features, **others}


UTM = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::25832"}}
TIMES = [PERIOD * step for step in range(STEPS)]
ON_EARTH = [
    point(degrees(x, y), person=who, time=PERIOD * t) for t, who, x, y in rows()
]
ON_A_MAP = [point((x, y), person=who, time=PERIOD * t) for t, who, x, y in rows()]
PATHS = [[degrees(*WALK[step, who]) for step in range(STEPS)] for who in range(PEOPLE)]
GEO = {
    "points": collection(ON_EARTH),
    "map": collection(ON_A_MAP, crs=UTM),
    "metres": collection(ON_A_MAP),
    "lines": collection([line(path, {"times": TIMES}) for path in PATHS]),
    "ids": collection(
        [line(path, {"coordTimes": TIMES}, id=who) for who, path in enumerate(PATHS)]
    ),
    "inner": collection(
        [line(path, {"coordinateProperties": {"times": TIMES}}) for path in PATHS]
    ),
    "four numbers": collection(
        [
            line([(*xy, 0, t) for xy, t in zip(path, TIMES)], {"name": "a"})
            for path in PATHS
        ]
    ),
}


@pytest.mark.parametrize("name", GEO)
@pytest.mark.parametrize("indent", [None, 1])
def test_geojson(tmp_path, name, indent):
    path = tmp_path / "a.geojson"
    path.write_text(json.dumps(GEO[name], indent=indent))
    (tracks,) = read_any(path)
    assert is_walk(tracks)
    assert tracks.reading.format == "json"
    notes = " ".join(tracks.reading.notes)
    assert ("degrees, as metres" in notes) == (name not in ("map", "metres"))
    assert ("not that far apart" in notes) == (name == "metres")


@pytest.mark.parametrize(
    "feature",
    [point([]), point([8.5]), point([None, None]), {**point([]), "geometry": None}],
)
def test_a_feature_without_a_position_is_a_row_left_out(tmp_path, feature):
    feature = {**feature, "properties": {"person": 1, "time": 99.0}}
    path = tmp_path / "a.geojson"
    path.write_text(json.dumps(collection([*ON_EARTH, feature])))
    (tracks,) = read_any(path)
    assert is_walk(tracks)
    assert tracks.reading.left_out == ("1 rows without a position",)


@pytest.mark.parametrize(
    "system",
    [
        None,
        {"type": "link", "properties": {"href": "a.prj"}},
        {"type": "name", "properties": {"name": "urn:ogc:def:crs:OGC:1.3:CRS84"}},
        {"type": "name", "properties": {"name": "EPSG:4258"}},
    ],
)
def test_systems_of_longitude_and_latitude(tmp_path, system):
    path = tmp_path / "a.geojson"
    path.write_text(json.dumps(collection(ON_EARTH, crs=system)))
    (tracks,) = read_any(path)
    assert is_walk(tracks)


AREA = {"type": "Polygon", "coordinates": [[(0, 0), (1, 0), (1, 1), (0, 0)]]}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            collection([line(PATHS[0], {"name": "a"})]),
            r"line without times: .*\(name, id",
        ),
        (collection([line(PATHS[0], {"times": [1, 2]})]), "is a list of 20"),
        (collection([{**line([], {}), "geometry": AREA}]), "feature 0 is a Polygon"),
        (collection([]), "has no points"),
        (collection(3), "cannot be read as a recording"),
        (collection([point(("a", 1))]), "cannot be read as a recording"),
        (collection([point([])]), "has no points"),
        (collection(ON_A_MAP, crs=[3]), "cannot be read as a recording"),
        (collection([point((1, 2), time=0)] * 3), "which column is id"),
    ],
)
def test_geojson_that_is_no_recording(tmp_path, content, message):
    (tmp_path / "a.geojson").write_text(json.dumps(content))
    with pytest.raises(InputError, match=message):
        read_any(tmp_path / "a.geojson")
