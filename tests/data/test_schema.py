"""Tables as people have them: each is read at the first try, or after pasting the printed command,
and says where everybody is. What is right is the crowd that the table was written from."""

import gzip
import itertools
import json
import re
import shlex
import sqlite3

import numpy as np
import polars as pl
import pytest
import tyro

from neurosym_jax.data import ReadOptions, read_any
from neurosym_jax.errors import InputError, InputWarning, spoken_as_flags
from studies.mistakes.crowd import CROWD, make_crowd

pytestmark = pytest.mark.filterwarnings("ignore::neurosym_jax.errors.InputWarning")
VIDEO = make_crowd(rate=25)
BOXES = 0.02  # metres of a pixel


def lines(form, crowd=CROWD, head="", **columns):
    """A line for each row by a format string of `step`, `id`, `x`, `y` and `t`."""
    names = {
        "step": crowd.step,
        "id": crowd.id,
        "x": crowd.x,
        "y": crowd.y,
        "t": crowd.t,
        **columns,
    }
    rows = (dict(zip(names, row)) for row in zip(*names.values()))
    return head + "".join(form.format(**row) + "\n" for row in rows)


def commas(text):
    return text.replace(".", ",")


PEOPLE: dict[int, dict[str, list[float]]] = {}
for person in np.unique(CROWD.id).tolist():
    own = CROWD.id == person
    way = {name: getattr(CROWD, name)[own].tolist() for name in ("t", "x", "y")}
    PEOPLE[person] = way
PIXELS = {"u": CROWD.x / BOXES, "v": 700 - CROWD.y / BOXES}
TABLES = {
    # name: content; "pasted" where one printed command is needed
    "capitals": lines("{step}0,{id},{x},{y}", head="FrameNo,ped,pos_x,pos_y\n"),
    "units in names": lines(
        "{ms},{id},{cx:.6f},{cy:.6f}",
        head="timestamp_ms,track_id,x_cm,y_cm\n",
        ms=400 * CROWD.step,
        cx=100 * CROWD.x,
        cy=100 * CROWD.y,
    ),
    "German": "Zeit [s];Person;X [m];Y [m]\n" + commas(lines("{t};{id};{x};{y}")),
    "PeTrack": lines(
        "{id} {step} {x} {y}", VIDEO, "# framerate: 25.00\n# id frame x/m y/m\n"
    ),
    "PeTrack, five columns in cm": lines(
        "{id} {step} {cx:.6f} {cy:.6f} 176",
        VIDEO,
        "# PeTrack\n# framerate: 25 fps\n# id frame x/cm y/cm z/cm\n",
        cx=100 * VIDEO.x,
        cy=100 * VIDEO.y,
    ),
    "an object a person": "\n".join(
        json.dumps({"id": who, **way}) for who, way in PEOPLE.items()
    ),
    "a list of people with points": json.dumps(
        [
            {"person": who, "points": list(zip(*way.values()))}
            for who, way in PEOPLE.items()
        ]
    ),
    "French": "temps;piéton;x;y\n" + commas(lines("{t};{id};{x};{y}")),
    "Spanish": lines(
        "{step}0\t{id}\t{x}\t{y}", head="fotograma\tpeatón\tposición_x\tposición_y\n"
    ),
    "Italian": lines("{id},{t},{x},{y}", head="pedone,tempo,posizione_x,posizione_y\n"),
    "Chinese": lines("{step}0,{id},{x},{y}", head="帧,行人,x,y\n"),
    "trackpy": lines("{y},{x},{step}0,{id}", head="y,x,frame,particle\n"),
    "camel case": lines(
        "{t},{id},{x},{y}", head="simTime,agentId,positionX,positionY\n"
    ),
    "an index, quotes": lines(
        '{step},"{t}","p{id}",{x},{y}', head=',"time","agent","x","y"\n'
    ),
    "z before y": lines("{step}0 {id} {x} 0.0 {y}", head="frame id x z y\n"),
    "velocities tell the rate": lines(
        "{step},{id},{x},{y},{vx:.5f},{vy:.5f}",
        VIDEO,
        "frame,id,x,y,vx,vy\n",
        vx=np.gradient(VIDEO.x) * 25,
        vy=np.gradient(VIDEO.y) * 25,
    ),
    "a label beside numbers, pasted": lines("{step}0 {id} Pedestrian {x} {y}"),
    "id before frame, pasted": lines("{id} {step}0 {x} {y}"),
    "id before frame, and a height, pasted": lines("{id}\t{step}0\t{x}\t{y}\t1.7"),
    "time first, pasted": lines("{t},{id},{x},{y},ok"),
    "units below the header": lines(
        '{t},{id},"{id:05}",1,{x},{y},1.7',
        head='"t","id","name","active","x","y","z"\n"s","","","","m","m","m"\n',
    ),
    "positions first, pasted": lines("{x};{y};{id};{t};0"),
    "names in no language, pasted": lines("{t},{id},{x},{y}", head="aa,bb,cc,dd\n"),
    "half of the names, pasted": lines(
        "{t},{id},{x},{y}", head="t,id,east_of_door,north_of_door\n"
    ),
    "a comment that names two, pasted": lines(
        "{id} {step}0 {x} {y} 0", head="# person frame\n"
    ),
}


def where(stamp, x, y):
    """[R, 3] seconds since the first, x and y, moment by moment from left to right."""
    rows = np.column_stack([stamp - np.min(stamp), x, y])
    return rows[np.lexsort((y, rows[:, 0].round(2)))]


def read_as_told(path, **options):
    """The recording, and the command that was pasted."""
    command = message = ""
    try:
        with spoken_as_flags():
            (tracks,) = read_any(path, ReadOptions(**options))
    except InputError as error:
        message, notes = str(error), getattr(error, "__notes__", [])
    if message:
        command = re.search(r"--columns (.*)$", message)[1]
        assert len(notes) == 1
        (tracks,) = read_any(
            path, ReadOptions(columns=tuple(shlex.split(command)), **options)
        )
    return tracks, command


@pytest.mark.parametrize("name", TABLES)
def test_at_the_first_try_or_after_pasting(tmp_path, name):
    path = tmp_path / "mine.csv"
    path.write_text(TABLES[name], encoding="utf-8")
    tracks, command = read_as_told(path)
    assert bool(command) == name.endswith("pasted")
    is_video = "PeTrack" in name or "rate" in name
    crowd = VIDEO if is_video else CROWD
    seconds = crowd.step / 25 if is_video else crowd.t
    result = where(tracks.stamp, *tracks.position.T)
    np.testing.assert_allclose(result, where(seconds, crowd.x, crowd.y), atol=1e-6)
    assert len(np.unique(tracks.id)) == len(np.unique(crowd.id))
    assert is_video == any(
        "25 frames a second" in note for note in tracks.reading.notes
    )


SCALE = 0.032  # that of the hint; the camera looks straight down
ROLES = "--columns time=t id=id x=u_px y=v_px"
FOLLOWED = {
    # content, and the options of the messages that are followed
    "every seventh frame": (lines("{f} {id} {x} {y}", f=7 * CROWD.step), ["--fps 25"]),
    "pixels": (
        lines("{t},{id},{u},{v}", head="t,id,u_px,v_px\n",
              u=CROWD.x / SCALE, v=-CROWD.y / SCALE), [ROLES, "--unit 0.032"]),
    "pixels and a homography": (
        lines("{t},{id},{u},{v}", head="t,id,u_px,v_px\n",
              u=CROWD.x / SCALE, v=-CROWD.y / SCALE), [ROLES, "--homography FILE"]),
    "two clocks": (
        lines("{f},{t},{id},{x},{y}", head="frame,time,id,x,y\n", f=CROWD.step % 7),
        ["say --columns time=time where that is"]),
}  # fmt: skip


@pytest.mark.parametrize("name", FOLLOWED)
def test_what_a_refusal_proposes_reads_the_file(tmp_path, name):
    content, hints = FOLLOWED[name]
    path = tmp_path / "mine.csv"
    path.write_text(content, encoding="utf-8")
    np.savetxt(tmp_path / "h.txt", np.diag([SCALE, -SCALE, 1]))
    words = []
    for hint in hints:
        with pytest.raises(InputError) as refused, spoken_as_flags():
            read_any(path, tyro.cli(ReadOptions, args=words))
        assert hint in str(refused.value)
        hint = hint.replace("FILE", str(tmp_path / "h.txt"))
        hint = hint.removeprefix("say ").removesuffix(" where that is")
        words += shlex.split(hint)
    (tracks,) = read_any(path, tyro.cli(ReadOptions, args=words))
    seconds = 7 * CROWD.step / 25 if "seventh" in name else CROWD.t
    np.testing.assert_allclose(
        where(tracks.stamp, *tracks.position.T),
        where(seconds, CROWD.x, CROWD.y),
        atol=1e-6,
    )


def test_nothing_is_proposed_for_what_are_no_tracks(tmp_path):
    """Boxes of one moment in seven cameras; XML; rows of unlike lengths."""
    rng = np.random.default_rng(0)
    box = {"xmin": 0, "ymin": 0, "xmax": 1, "ymax": 1}
    people = []
    for person in range(20):
        views = []
        for view in range(7):
            corners = dict(zip(box, rng.integers(2000, size=4).tolist()))
            views.append({"viewNum": view, **corners})
        people.append({"personID": person, "views": views})
    for content, says in (
        (json.dumps(people), "which column is time or frame.*none that reads it"),
        ("<result>\n<frame number='1'>\n</result>\n", "XML is not read"),
        ("591\n116 2\n0 1 2 3\n4 5 6 7 8\n", "this is no table"),
    ):
        path = tmp_path / "mine.json"
        path.write_text(content)
        with pytest.raises(InputError, match=says):
            read_any(path)


def test_another_run_of_the_same_people_is_no_other_camera(tmp_path):
    """They stand where they stood, ten seconds later; a camera that goes on does so at once."""
    path = tmp_path / "a.csv"
    for gap, warned in ((10, False), (0.4, True)):
        rows = []
        for run, step, who in itertools.product((0, 1), range(5), range(3)):
            seconds = 0.4 * step + run * (1.6 + gap)
            rows.append(f"{seconds:.1f},{who},{5 * who},{0.1 * step},{run}")
        path.write_text("\n".join(["t,id,x,y,run", *rows]))
        recordings = read_any(path)
        assert len(recordings) == 2
        lines = " ".join(recordings[0].reading.warnings)
        assert ("goes on in another recording" in lines) == warned


def test_a_label_that_a_user_names_may_be_of_each_person(tmp_path):
    """Others are not looked at then, whatever they say."""
    path = tmp_path / "a.csv"
    names = [f"guest{person}" for person in CROWD.id]
    path.write_text(
        lines(
            "{t},{id},{x},{y},{name},robot", head="t,id,x,y,name,seen_by\n", name=names
        )
    )
    read = ReadOptions(columns=("label=name",), keep=("guest1", "guest2"))
    (tracks,) = read_any(path, read)
    assert set(tracks.id) == {1, 2}


def test_question_marks_are_people_who_are_not_seen(tmp_path):
    """As in the tests of the TrajNet challenge, whose futures are withheld."""
    part = CROWD.step % 20 < 8
    text = lines("{step}0 {id}.0 {x} {y}").splitlines()
    text = [
        row if seen else " ".join([*row.split()[:2], "? ?"])
        for row, seen in zip(text, part)
    ]
    path = tmp_path / "mine.txt"
    path.write_text("\n".join(text))
    (tracks,) = read_any(path)
    truth = where(*(values[part] for values in (CROWD.t, CROWD.x, CROWD.y)))
    np.testing.assert_allclose(
        where(tracks.stamp, *tracks.position.T), truth, atol=1e-6
    )


def test_a_row_with_numbers_where_others_have_them_is_data(shared):
    """180 rows, 6 people; and numbers of columns are no values of the first row."""
    for name in ("no_header", "swapped"):
        path = shared / f"cases/tables/label_{name}.txt"
        rows = [line.split() for line in path.read_text().splitlines()]
        tracks, command = read_as_told(path)
        assert command == "frame=1 id=2 x=4 y=5"
        truth = sorted(
            (int(r[1]), int(r[0]) * 0.4, float(r[3]), float(r[4])) for r in rows
        )
        result = np.column_stack([tracks.id, tracks.stamp, tracks.position])
        np.testing.assert_allclose(result, truth, atol=1e-9)


def test_flags_act_by_position_as_by_name(tmp_path, shared):
    """MOTChallenge's confidence 0 and classes 7 and 12 are no people; feet are below."""
    path = shared / "cases/tables/mot_gt_like.txt"
    rows = np.loadtxt(path, delimiter=",")
    people = rows[(rows[:, 6] > 0) & (rows[:, 7] == 1)]
    truth = (
        np.column_stack([people[:, 2] + people[:, 4] / 2, -people[:, 3] - people[:, 5]])
        * BOXES
    )
    roles = "frame=1 id=2 left=3 top=4 width=5 height=6 confidence=7 label=8"
    named = tmp_path / "named.csv"
    head = "frame,id,bb_left,bb_top,bb_width,bb_height,conf,class,vis\n"
    named.write_text(head + path.read_text())
    for file, columns in ((path, ()), (path, tuple(roles.split())), (named, ())):
        options = {"unit": str(BOXES), "fps": 25.0, "columns": columns}
        options |= {"keep": ("1",)} if columns or file == named else {}
        (tracks,) = read_any(file, ReadOptions(**options))
        order = np.lexsort((people[:, 0], people[:, 1]))
        np.testing.assert_allclose(tracks.position, truth[order], atol=1e-9)
        np.testing.assert_allclose(tracks.stamp, people[order, 0] / 25)
    with pytest.raises(
        InputError, match=r"pixels of a picture.*homography='FILE' or .* unit="
    ):
        read_any(path)
    with pytest.raises(InputError, match="every frame of a video"):
        read_any(path, ReadOptions(unit="0.02"))


def test_stanford_boxes(tmp_path):
    """Whole pixels at 30 frames a second are not held; boxes that are lost are left out."""
    rows, people = [], []
    for person in range(12):
        u, v, angle = 200 + 55 * person, 300 + 20 * person, person / 2
        for step in range(300):
            at = min(step, 200)
            pace = 0.6 + 0.05 * person  # Some stay at a pixel for a frame.
            x, y = (
                round(u + pace * np.cos(angle) * at),
                round(v + pace * np.sin(angle) * at),
            )
            rows.append(
                (
                    person,
                    x,
                    y,
                    x + 30,
                    y + 36,
                    step,
                    int(step > 200),
                    0,
                    1,
                    '"Pedestrian"',
                )
            )
            if step <= 200:
                people.append((person, step / 30, 0.036 * (x + 15), -0.036 * (y + 36)))
    rows.append((99, 0, 0, 9, 9, 3, 0, 0, 0, '"Biker"'))
    path = tmp_path / "annotations.txt"
    path.write_text("".join(" ".join(map(str, row)) + "\n" for row in rows))
    (tracks,) = read_any(path, ReadOptions(unit="0.036", fps=30.0))
    result = np.column_stack([tracks.id, tracks.stamp, tracks.position])
    np.testing.assert_allclose(result, people, atol=1e-9)
    assert tracks.reading.format == "stanford"
    assert not any("held" in line for line in tracks.reading.warnings)


def drone(path, speed, **metadata):
    """Two dozen on straight ways at 25 frames a second, their velocities, and files beside."""
    rows = [
        f"0,{who},{step},{speed * step / 25 + who},{3 * who},{speed},0.0"
        for who, step in itertools.product(range(24), range(150))
    ]
    head = "recordingId,trackId,frame,xCenter,yCenter,xVelocity,yVelocity"
    path.write_text("\n".join([head, *rows]))
    for name, text in metadata.items():
        (path.parent / f"00_{name}Meta.csv").write_text(text)
    return path


def test_cars_do_not_pass_as_people(tmp_path):
    path = drone(tmp_path / "00_tracks.csv", 10.0)
    with pytest.raises(InputError, match=r"faster than 10\.00 m/s"):
        read_any(path)
    (tracks,) = read_any(drone(path, 1.3))
    (rate,) = tracks.reading.notes
    assert rate.startswith(
        "25 frames a second (columns xVelocity, yVelocity alone, which may err"
    )
    assert np.ptp(tracks.stamp) == pytest.approx(149 / 25)
    kinds = "trackId,class\n" + "".join(
        f"{who},{['car', 'pedestrian'][who % 2]}\n" for who in range(24)
    )
    (tracks,) = read_any(drone(path, 1.3, tracks=kinds, recording="frameRate\n25\n"))
    assert set(tracks.id) == set(range(1, 24, 2))


def test_the_first_word_of_a_kind_says_it(tmp_path):
    """CARLA's and nuScenes' kinds: each actor may have a blueprint of its own."""
    kinds = ["walker.pedestrian.00{}", "human.pedestrian.adult", "vehicle.tesla.no{}"]
    for each in range(2):
        rows = [
            f"{who},{[kinds[each], kinds[2]][who % 2].format(who)},{0.4 * step},"
            f"{0.5 * step},{3 * who}"
            for who, step in itertools.product(range(24), range(20))
        ]
        path = tmp_path / "a.csv"
        path.write_text("\n".join(["actor_id,type_id,timestamp,x,y", *rows]))
        (tracks,) = read_any(path)
        assert set(tracks.id) == set(range(0, 24, 2))
        (line,) = tracks.reading.left_out
        assert line.startswith("240 rows with type_id vehicle.tesla.no1, vehicle")
        (tracks,) = read_any(path, ReadOptions(keep=("vehicle.tesla.no1",)))
        assert set(tracks.id) == {1}


def test_a_robot_among_the_ids_is_no_person(tmp_path):
    """Logs of simulators call the robot so in the column of agents."""
    path = tmp_path / "a.csv"
    head = "time,agent,x,y\n"
    rows = [
        f"{0.4 * step:.1f},{who},{0.5 * step},{3 * at}"
        for step, (at, who) in itertools.product(
            range(20), enumerate(["human_1", "Robot", "human_2", ""])
        )
    ]
    path.write_text(head + "\n".join(rows))
    (tracks,) = read_any(path)
    assert tracks.names == ("human_1", "human_2")
    robots, nobody = tracks.reading.left_out
    assert (robots[:16], nobody) == ("20 rows of robot", "20 rows with no id or -1")
    columns = tuple(re.findall(r"'([^']+)'", robots))
    (tracks,) = read_any(path, ReadOptions(columns=columns, keep=("robot", "human")))
    assert tracks.names == ("Robot", "human_1", "human_2")
    path.write_text(path.read_text().replace("human", "robot"))
    (tracks,) = read_any(path)
    assert len(tracks.names) == 3


@pytest.mark.parametrize(
    ("names", "left"),
    [
        (["van Dijk", "Bus", "Jansen"], ["bus"]),
        (["van Dijk", "Vanessa", "Carter"], []),
        (["car_3", "Vehicle 12", "anna"], ["car_3", "vehicle 12"]),
    ],
)
def test_people_may_be_called_as_vehicles_begin(tmp_path, names, left):
    rows = [
        f"{t / 10},{name},{t / 10},{y}"
        for y, name in enumerate(names)
        for t in range(40)
    ]
    path = tmp_path / "names.csv"
    path.write_text("\n".join(["time,id,x,y", *rows]))
    (tracks,) = read_any(path, ReadOptions())
    assert len(tracks.names) == len(names) - len(left)
    assert all(name in str(tracks.reading.left_out) for name in left)
    assert bool(tracks.reading.left_out) == bool(left)


def test_simulators_name_their_robot_and_their_worlds(tmp_path):
    """Rows of a robot are no person's; people of two worlds never meet."""
    path = tmp_path / "a.csv"
    rows = [
        f"{world},{400_000 * step},{who + 10 * world},{0.5 * step},{3 * who + 20 * world},{who // 3}"
        for world, step, who in itertools.product(range(2), range(20), range(4))
    ]
    head = "env_id,timestamp_micros,agent_id,x,y,is_robot\n"
    path.write_text(head + "\n".join(rows))
    first, second = read_any(path)
    assert (set(first.id), set(second.id)) == ({0, 1, 2}, {10, 11, 12})
    assert np.ptp(first.stamp) == pytest.approx(19 * 0.4)
    assert first.reading.left_out == ("40 rows with is_robot 1",)
    (tracks,) = read_any(path, ReadOptions(columns=("lost=none", "part=env_id")))
    assert set(tracks.id) == {0, 1, 2, 3, 10, 11, 12, 13}


def test_an_answer_shows_people_by_their_names(tmp_path):
    path = tmp_path / "a.csv"
    names = [f"ann_{person}" for person in CROWD.id]
    path.write_text(lines("{t},{name},{x},{y}", head="time,who,x,y\n", name=names))
    with pytest.raises(
        InputError, match=r"say columns=\('time=time', 'id=who'"
    ) as caught:
        read_any(path)
    (preview,) = caught.value.__notes__
    assert f"id ann_{CROWD.id.min()}, x" in preview


def test_a_number_is_no_kind_where_a_text_is(tmp_path):
    """Argoverse's object_category is a number beside object_type."""
    rows = [
        f"{who},{['pedestrian', 'vehicle'][who % 2]},{who % 4},{step},{0.13 * step},{3 * who}"
        for who, step in itertools.product(range(8), range(110))
    ]
    path = tmp_path / "a.csv"
    path.write_text(
        "\n".join(["track_id,object_type,object_category,frame,x,y", *rows])
    )
    for keep in ((), ("pedestrian",)):
        (tracks,) = read_any(path, ReadOptions(keep=keep, fps=10.0))
        assert set(tracks.id) == {0, 2, 4, 6}
    with pytest.raises(InputError, match="keep which are people"):
        read_any(path, ReadOptions(keep=("tram",), fps=10.0))
    path.write_text(
        path.read_text().replace("pedestrian", "").replace("vehicle", "van")
    )
    with pytest.raises(
        InputError, match="'object_type' has nothing, van: say with keep"
    ):
        read_any(path, ReadOptions(keep=("tram",), fps=10.0))


def test_objects_in_rows_are_columns(tmp_path):
    """A position may be an object or a pair of numbers, in a frame or at any depth of JSON."""
    places = np.column_stack([CROWD.x, CROWD.y])
    objects = [dict(zip("xy", place)) for place in places.tolist()]
    ids, times = CROWD.id.tolist(), CROWD.t.tolist()
    for name, points in (("pairs", places.tolist()), ("objects", objects)):
        frame = pl.DataFrame({"time": times, "track": ids, "position": points})
        frame.write_parquet(tmp_path / f"{name}.parquet")
        (tmp_path / f"{name}.json").write_text(json.dumps(frame.to_dicts()))
        moments = []
        for time, rows in frame.group_by("time", maintain_order=True):
            people = rows.drop("time").to_dicts()
            moments.append({"time": time[0], "people": people})
        (tmp_path / f"deep_{name}.json").write_text(json.dumps({"all": moments}))
    paths = sorted(tmp_path.iterdir())
    assert len(paths) == 6
    for path in paths:
        (tracks,) = read_any(path)
        order = np.lexsort((CROWD.t, CROWD.id))
        np.testing.assert_allclose(tracks.position, places[order], atol=1e-9)
        np.testing.assert_allclose(tracks.stamp, CROWD.t[order], atol=1e-9)


@pytest.mark.parametrize("clock", ["timestamps", "frames", None])
def test_a_third_number_is_a_time_or_a_height(tmp_path, clock):
    """It is a time in front where nothing else is a clock, and else a height behind."""
    people = []
    for person, way in PEOPLE.items():
        places = np.column_stack([way["x"], way["y"], np.full(len(way["t"]), 0.9)])
        if clock is None:
            places = np.column_stack([way["t"], way["x"], way["y"]])
        people.append({"id": person, "trajectory": places.tolist()})
        if clock:
            steps = np.array(way["t"]) / (0.4 if clock == "frames" else 1)
            people[-1][clock] = steps.round(6).tolist()
    path = tmp_path / "a.json"
    path.write_text(json.dumps(people))
    (tracks,) = read_any(path)
    order = np.lexsort((CROWD.t, CROWD.id))
    places = np.column_stack([CROWD.x, CROWD.y])
    np.testing.assert_allclose(tracks.position, places[order], atol=1e-9)


def test_messages_of_a_robot_as_json(tmp_path):
    """As bridges write them: poses in poses, with orientations and velocities, and a frame's name."""
    messages = []
    for t, who, x, y in zip(
        *(getattr(CROWD, name).tolist() for name in ["t", "id", "x", "y"])
    ):
        place = {
            "position": {"x": x, "y": y, "z": 0},
            "orientation": {"x": 0, "y": 0, "w": 1},
        }
        nanoseconds = round(1e9 * t)
        stamp = {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}
        tracks = [
            {
                "track_id": who,
                "pose": {"pose": place},
                "twist": {"linear": {"x": 1, "y": 0}},
            }
        ]
        messages.append(
            {"header": {"stamp": stamp, "frame_id": "map"}, "tracks": tracks}
        )
    path = tmp_path / "a.jsonl"
    path.write_text("\n".join(map(json.dumps, messages)))
    (tracks,) = read_any(path)
    order = np.lexsort((CROWD.t, CROWD.id))
    places = np.column_stack([CROWD.x, CROWD.y])
    np.testing.assert_allclose(tracks.position, places[order], atol=1e-9)
    np.testing.assert_allclose(tracks.stamp, CROWD.t[order], atol=1e-6)


def test_a_proposed_x_and_y_are_of_one_kind(tmp_path):
    path = tmp_path / "a.csv"
    rows = lines("{step}0,{id},{u},{v},{x},{y}", u=30 * CROWD.x, v=-30 * CROWD.y)
    path.write_text("frame,id,x,y,x_world,y_world\n" + rows)
    with pytest.raises(InputError, match="which column is x, y") as caught:
        read_any(path)
    pairs = re.findall(r"'x=(\w+)', 'y=(\w+)'", str(caught.value))
    assert pairs == [("x", "y"), ("x_world", "y_world")]


def test_a_table_without_numbers_is_asked_for(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(
        "time,id,place\n" + "".join(f"{t},{t % 2},here\n" for t in range(9))
    )
    with pytest.raises(InputError, match=r"which column is x, y\? There are 'time'"):
        read_any(path)


@pytest.mark.parametrize("kind", ["gz", "sqlite", "hdf5", "parquet", "arrow"])
def test_files_that_are_no_text(tmp_path, kind):
    """Jülich's database and HDF5 say their rate."""
    path = tmp_path / f"mine.{kind}"
    frame = pl.DataFrame(
        {"id": VIDEO.id, "frame": VIDEO.step, "pos_x": VIDEO.x, "pos_y": VIDEO.y}
    )
    options = (
        ReadOptions(fps=25.0) if kind in ("gz", "parquet", "arrow") else ReadOptions()
    )
    if kind == "gz":
        path.write_bytes(gzip.compress(frame.write_csv().encode()))
    elif kind == "sqlite":
        with sqlite3.connect(path) as base:
            base.execute("create table metadata (key text, value text)")
            base.executemany(
                "insert into metadata values (?, ?)",
                [("version", "2"), ("fps", "25.0")],
            )
            base.execute(
                "create table trajectory_data (id int, frame int, pos_x real, pos_y real)"
            )
            base.executemany(
                "insert into trajectory_data values (?, ?, ?, ?)", frame.rows()
            )
    elif kind == "hdf5":
        h5py = pytest.importorskip("h5py")
        kinds = [("id", int), ("frame", int), ("x", float), ("y", float)]
        with h5py.File(path, "w") as file:
            file["trajectory"] = np.array(frame.rows(), dtype=kinds)
            file["trajectory"].attrs["fps"] = 25.0
    else:
        getattr(frame, {"parquet": "write_parquet", "arrow": "write_ipc"}[kind])(path)
    (tracks,) = read_any(path, options)
    result = where(tracks.stamp, *tracks.position.T)
    np.testing.assert_allclose(
        result, where(VIDEO.step / 25, VIDEO.x, VIDEO.y), atol=1e-6
    )


def test_a_whole_table_is_one_person(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t,x,y\n0,1,2\n0.4,1.5,2\n0.8,2,2\n")
    (tracks,) = read_any(path, ReadOptions(columns=("id=none",)))
    assert tracks.id.tolist() == [0, 0, 0]


def test_rows_in_an_object_with_other_fields(tmp_path):
    rows = [{"t": 0.4 * step, "id": 1, "x": step, "y": 2} for step in range(3)]
    person: dict[str, object] = {"id": 1}
    for name in ("t", "x", "y"):
        person[name] = [row[name] for row in rows]
    people = [person]
    for content in (
        {"place": "hall", "rows": rows},
        {"place": "hall", "people": people},
    ):
        path = tmp_path / "a.json"
        path.write_text(json.dumps(content))
        (tracks,) = read_any(path)
        assert tracks.position.tolist() == [[0, 2], [1, 2], [2, 2]]


def test_a_name_that_stands_twice_in_an_object_keeps_its_part(tmp_path):
    """The last x would be a velocity's, the last id a camera's, the last row all of a table."""
    path, at = tmp_path / "a.json", [(0.4 * step, step, 2.0) for step in range(3)]
    parts = [
        {
            "t": t,
            "p": {"id": 7, "x": x, "y": y},
            "camera": {"id": 0},
            "velocity": {"x": 1, "y": 0},
        }
        for t, x, y in at
    ]
    path.write_text(json.dumps(parts))
    (tracks,) = read_any(path, ReadOptions(columns=("x=p.x", "y=p.y", "id=p.id")))
    assert (tracks.id.tolist(), tracks.position[:, 0].tolist()) == ([7] * 3, [0, 1, 2])
    way = {
        "t": [t for t, *_ in at],
        "position": [xy for _, *xy in at],
        "velocity": [[1, 0]] * 3,
    }
    path.write_text(json.dumps({"id": 7, **way}))
    (tracks,) = read_any(path)
    assert tracks.position[:, 0].tolist() == [0, 1, 2]
    path.write_text(
        json.dumps(
            {n: {"t": t, "id": 7, "x": x, "y": y} for n, (t, x, y) in enumerate(at)}
        )
    )
    (tracks,) = read_any(path)  # Rows by number, as pandas writes them.
    assert tracks.position[:, 0].tolist() == [0, 1, 2]


@pytest.mark.parametrize(
    ("text", "commas"), [("a, b", False), ("1,5", True), ("1,5 and .5", True)]
)
def test_commas_are_decimal_between_digits_alone(tmp_path, text, commas):
    """Positions are whole numbers, and a column that nobody asked for has commas."""
    path = tmp_path / "a.csv"
    path.write_text(f"t;id;x;y;note\n0;1;2;3;{text}\n1;1;3;3;{text}\n")
    (tracks,) = read_any(path)
    assert ("decimal commas" in tracks.reading.notes) == commas


def test_velocities_are_in_the_unit_of_the_file(tmp_path):
    rows = []
    for step, who in itertools.product(range(100), (1, 2, 3)):
        rows.append(f"{step},{100 * who},{who},{step / 25 * 120},120,0")
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["frame,y_cm,id,x_cm,vx,vy", *sorted(rows)]))
    (tracks,) = read_any(path)
    assert tracks.reading.notes[1].startswith("25 frames a second (columns vx, vy")


@pytest.mark.parametrize("rate", [29.97, 23.976, 59.94, 12.5])
def test_rates_of_videos_that_only_velocities_tell(tmp_path, rate):
    rows = [f"{step},{step / rate * 1.2},1,1.2,0" for step in range(200)]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["frame,x,y,vx,vy", *rows]))
    (tracks,) = read_any(path, ReadOptions(columns=("id=none",)))
    assert tracks.reading.notes[0].startswith(
        f"{rate:g} frames a second (columns vx, vy alone"
    )


def test_not_seen_is_no_position(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(
        "t,id,x,y\n0,1,1,2\n0.4,1,,\n0.8,1,nan,NA\n1.2,1,3,4\n"
    )  # NA is R's.
    (tracks,) = read_any(path)
    assert tracks.position.tolist() == [[1, 2], [3, 4]]
    assert tracks.reading.warnings == ("2 rows without a position are left out",)
    path.write_text("t,id,x,y\n0,1,,\n")
    with pytest.raises(InputError, match="no row has a position"):
        read_any(path)


def test_a_unit_for_each_file_and_two_that_disagree(tmp_path):
    for name in ("gates", "quad"):
        (tmp_path / f"{name}.csv").write_text("t,id,x,y\n0,1,100,200\n")
    read = ReadOptions(unit="gates=0.5,quad=cm")
    result = [
        read_any(tmp_path / f"{name}.csv", read)[0].position.tolist()
        for name in ("gates", "quad")
    ]
    assert result == [[[50, 100]], [[1, 2]]]
    other = ReadOptions(unit="gate=0.5", fps="gate=5")  # A time needs no rate.
    with pytest.warns(InputWarning, match="unit='gate=0.5' does not name gates"):
        (tracks,) = read_any(tmp_path / "gates.csv", other)
    assert tracks.reading.warnings[1:] == ("fps='gate=5' does not name gates",)
    path = tmp_path / "cm.csv"
    path.write_text("t,id,x_cm,y_cm\n0,1,100,200\n")
    with pytest.raises(
        InputError, match=r"says that coordinates are cm, unit='mm'.*allow=.'scale'"
    ):
        read_any(path, ReadOptions(unit="mm"))
    (tracks,) = read_any(path, ReadOptions(unit="mm", allow=("scale",)))
    assert tracks.position.tolist() == [[0.1, 0.2]]


def test_header_can_be_said(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("1,2,3,4\n0,7,1,2\n")
    columns = ("frame=1", "id=2", "x=3", "y=4")
    for header, rows in (("no", 2), ("yes", 1)):
        (tracks,) = read_any(path, ReadOptions(columns=(*columns, f"header={header}")))
        assert len(tracks.id) == rows
    with pytest.raises(InputError, match="header=maybe: say header=no"):
        read_any(path, ReadOptions(columns=(*columns, "header=maybe")))


def test_people_abreast_in_tenths_of_a_second_are_read_as_they_stand(tmp_path):
    """Across a row of people all is as smooth as along a track; but no id has a fraction."""
    rng = np.random.default_rng(0)
    rows = []
    for time, person in itertools.product(range(100), range(6)):
        x, y = rng.normal((0.12 * time, 1.5 * person), 0.02)
        rows.append(f"{time / 10},{person},{x:.3f},{y:.3f}")
    path = tmp_path / "abreast.csv"
    path.write_text("\n".join(rows))
    columns = ("time=1", "id=2", "x=3", "y=4")
    with pytest.raises(
        InputError, match=r"frame 0\.1 is not a whole number"
    ) as refusal:
        read_any(path)
    assert f"columns={columns}" in str(refusal.value)
    (tracks,) = read_any(path, ReadOptions(columns=columns))
    assert set(tracks.id.tolist()) == set(range(6))


def test_units_below_the_header_are_read(tmp_path):
    path = tmp_path / "a.csv"
    form = "{t:.1f},{id},{x:.1f},{y:.1f}"
    millimetres = {"x": 1000 * CROWD.x, "y": 1000 * CROWD.y}
    path.write_text(lines(form, head="time,id,x,y\n[s],,[mm],[mm]\n", **millimetres))
    (tracks,) = read_any(path)
    (metres,) = read_any(pl.DataFrame({"time": CROWD.t, "id": CROWD.id, **xy()}))
    np.testing.assert_allclose(tracks.position, metres.position, atol=1e-3)
    assert any("coordinates in mm" in note for note in tracks.reading.notes)


def xy():
    return {"x": CROWD.x, "y": CROWD.y}


def test_one_person_at_a_sentinel_leaps_until_it_is_said(tmp_path):
    """Where several share it, it is found."""
    t = 0.4 * np.arange(60)
    x = np.where(np.arange(60) % 9 == 4, -9999.0, t)
    y = np.where(x == -9999, -9999.0, np.sin(t))
    frame = pl.DataFrame({"time": t, "id": np.ones(60, int), "x": x, "y": y})
    frame.write_csv(tmp_path / "a.csv")
    with pytest.warns(InputWarning, match="14 steps are faster than 10 m/s"):
        read_any(tmp_path / "a.csv")
    (tracks,) = read_any(tmp_path / "a.csv", ReadOptions(missing=-9999))
    assert len(tracks.id) == 53


@pytest.mark.parametrize("share", [0.1, 0.4])
def test_columns_are_proposed_where_many_positions_are_missing(tmp_path, share):
    rng = np.random.default_rng(0)
    is_missing = rng.random(len(CROWD.t)) < share
    frame = pl.DataFrame({"when": CROWD.t, "who": CROWD.id, "a": CROWD.x, "b": CROWD.y})
    frame = frame.with_columns(noise=rng.random(len(frame)))
    hidden = pl.Series(is_missing)
    columns = [pl.when(~hidden).then(pl.col(name)).alias(name) for name in "ab"]
    frame.with_columns(columns).write_csv(tmp_path / "a.csv")
    with pytest.raises(InputError, match=r"'time=when', 'id=who', 'x=a', 'y=b'"):
        read_any(tmp_path / "a.csv")
