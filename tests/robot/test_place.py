"""A place that a stream teaches: it helps, it harms nobody, and its file is always whole."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import neurosym_jax as nj
from neurosym_jax.errors import InputError
from neurosym_jax.models.baselines import ConstantVelocitySampled
from neurosym_robot import Analytics, Moments, Predictor, Status, read_frames
from neurosym_robot.commands import replay
from neurosym_robot.commands._place_file import PlaceFile, open_place
from neurosym_robot.input.source import PeopleSource
from neurosym_robot.online.replay import ReplayEvent
from neurosym_robot.tracking.following import Frame
from tests.compiling import compile_seconds
from tests.robot.recordings import walkers, write_people

PERIOD = 0.4
EVENT = ReplayEvent(Frame(0.0, np.zeros(0, int), np.zeros((0, 2))), None)


def make_model():
    config = ConstantVelocitySampled.Config(obs_len=8, pred_len=12)
    return nj.Model(config, {}, family="constant_velocity_sampled")


@pytest.fixture(scope="module")
def model():
    """Quick to compile, and wrong wherever people turn."""
    return make_model()


def corner(people: int, turn: float = 1.0, begin: float = 0.0):
    """Frames of people who follow each other around a corner, every 4 s for 14 s each."""
    frames = []
    for step in range(10 * people):
        time = step * PERIOD
        ids = [n for n in range(people) if 0 <= time - 4 * n < 14]
        places = []
        for person in ids:
            way = (1.0 + 0.05 * (person % 5)) * (time - 4 * person)
            side = 0.1 * (person % 3)
            place = [way, side] if way < 8 else [8 - side, turn * (way - 8)]
            places.append(place)
        frames.append(Frame(begin + time, np.array(ids), np.array(places)))
    return frames


def predictor_at(place, model, **options):
    options = {"samples": 20, "max_people": 4, "compile": "needed"} | options
    return Predictor(model, place=place, **options)


def teach(model, people):
    """A predictor that has watched so many people at a corner, and its forecasts."""
    predictor = predictor_at(nj.Place(model), model)
    forecasts = [predictor.push(*frame) for frame in corner(people)]
    return predictor, forecasts


@pytest.fixture(scope="module")
def taught(model):
    return teach(model, people=20)


@pytest.fixture(scope="module")
def taught_by_few(model):
    """Enough for what is shown of it."""
    return teach(model, people=8)


@pytest.mark.slow
def test_it_learns_where_people_turn(model, taught):
    predictor, forecasts = taught
    people, alone, used = predictor.place.scored
    assert people > 120
    assert used < 0.85 * alone

    other = predictor_at(None, model)
    errors: dict[bool, list[float]] = {False: [], True: []}
    frames = corner(20)
    for number, frame in enumerate(frames):
        plain = other.push(*frame)
        if not 120 < number < 185:
            continue
        (with_place,), (without,) = (
            forecast.models.values() for forecast in (forecasts[number], plain)
        )
        # The published forecast is the model's own, bit for bit.
        assert_array_equal(with_place.samples, without.samples)
        assert with_place.central == without.central
        later = frames[number + 12]
        for row, person in enumerate(plain.ids.tolist()):
            if person in later.ids:
                truth = later.xy[later.ids == person][0]
                for is_taught, result in ((True, with_place), (False, without)):
                    end = result.draws[:, row, -1]
                    errors[is_taught].append(np.linalg.norm(end - truth, axis=1).mean())
    assert len(errors[True]) > 50
    assert np.mean(errors[True]) < 0.7 * np.mean(errors[False])


@pytest.mark.slow
def test_draws_are_the_models_own_before_anything_was_learned(model):
    place, other = predictor_at(nj.Place(model), model), predictor_at(None, model)
    for frame in corner(3)[:12]:
        (first,) = place.push(*frame).models.values()
        (second,) = other.push(*frame).models.values()
        assert_allclose(first.draws, second.draws, atol=1e-5)


@pytest.mark.slow
def test_a_forecast_waits_for_nothing_that_is_learned(model):
    """Learning comes after it, at the latest before the next one, and to the same bits."""
    at_once, later = (predictor_at(nj.Place(model), model) for _ in range(2))
    for frame in corner(3):
        known = at_once.place.seconds
        at_once.push(*frame)
        later.window.push(*frame)
        later.forecast()
        assert later.place.seconds == known
    later.learn()
    later.learn()
    for name, array in at_once.place.contents().items():
        assert_array_equal(later.place.contents()[name], array, err_msg=name)


@pytest.mark.slow
def test_what_was_learned_elsewhere_harms_nobody(model, taught, tmp_path):
    """People turn to the other side now: the bound holds, and then it is learned anew."""
    taught[0].place.save(tmp_path / "left.npz")
    place = nj.load_place(tmp_path / "left.npz", model)
    before, limit = place.scored, place.limit
    predictor = predictor_at(place, model)
    sums = [before]
    for frame in corner(20, turn=-1.0):
        predictor.push(*frame)
        sums.append(place.scored)
    people, alone, used = np.subtract(sums[-1], before)
    assert people > 120
    assert used - alone <= 2 * max(limit, place.limit)
    people, alone, used = np.subtract(sums[-1], sums[120])
    assert used < 0.95 * alone


def test_the_status_says_what_it_brought(taught_by_few):
    predictor, _ = taught_by_few
    status = Status(predictor, Analytics(predictor), interval=0.0)
    assert "memory of the place: up to " in status.line()
    assert "% lower than without it in 1 minutes" in status.now()["place"]
    assert status.now()["place"] in status.table()


def test_the_page_shows_what_it_taught(taught_by_few):
    """Rows of flows turn where people turn, and come once in half a minute."""
    predictor, forecasts = taught_by_few
    status = Status(predictor, Analytics(predictor), interval=0.0)
    moments = Moments(predictor)
    assert json.loads(moments.introduction)["place"] is True
    lines = []
    for stamp in (1.0, 1.1):
        event = ReplayEvent(EVENT.frame._replace(stamp=stamp), forecasts[-1])
        lines.append(json.loads(moments.moment(event, status.now())))
    assert lines[1]["flows"] is None
    assert "flows" not in lines[0]["now"]
    x, y, way_x, way_y, share, people = np.array(lines[0]["flows"]).T
    assert len(x) > 3
    is_before = x < 6
    is_behind = y > 1
    assert np.all(way_x[is_before] > 2)
    assert way_y[is_behind] == pytest.approx(5.5, abs=0.5)
    assert np.any(is_before)
    assert np.any(is_behind)
    assert people.max() == pytest.approx(6, abs=1)
    assert share.max() <= 1


@pytest.mark.slow
def test_the_page_shows_nothing_of_a_memory_that_was_dropped(model):
    place = nj.Place(model)
    predictor = predictor_at(place, model)
    status = Status(predictor, Analytics(predictor), interval=0.0)
    moments = Moments(predictor)
    rows = []
    for begin, is_dropped in ((0.0, False), (1000.0, True)):
        for frame in corner(10, begin=begin):
            place.watch(frame.xy, frame.ids, frame.stamp)
        if is_dropped:
            place._drop()
        event = ReplayEvent(EVENT.frame._replace(stamp=begin + 1), None)
        rows.append(json.loads(moments.moment(event, status.now()))["flows"])
    assert len(rows[0]) > 5
    assert rows[1] == []


def test_somebody_out_of_sight_teaches_nothing(model):
    place = nj.Place(model)
    predictor = predictor_at(place, model, hold=9.0)
    for number, frame in enumerate(corner(1) + corner(3)[30:]):
        if number < 10:
            predictor.push(*frame)
        else:
            predictor.push(0.4 * number, frame.ids[:0], frame.xy[:0])
    assert place.moments == 0
    assert len(predictor.forecast().ids) == 1


def test_a_clock_set_back_begins_another_stream(model):
    predictor = predictor_at(nj.Place(model), model)
    for frame in corner(3, begin=1000.0) + corner(3):
        assert predictor.push(*frame) is not None
    assert predictor.health["clock_resets"] == 1
    assert predictor.place.seconds == pytest.approx(60 * PERIOD)


@pytest.mark.slow
def test_nothing_is_compiled_amid_a_stream(model):
    predictor = predictor_at(nj.Place(model, moments=500), model, compile="start")
    frames = corner(8)
    predictor.push(*frames[0])
    before = compile_seconds()
    for frame in frames[1:]:
        (result,) = predictor.push(*frame).models.values()
        result.regions  # noqa: B018
    assert compile_seconds() == before


def test_a_place_of_another_model_or_period_is_refused(model):
    with pytest.raises(InputError, match="another model"):
        Predictor(model, place=nj.Place(make_model()))
    with pytest.raises(InputError, match=r"steps of 0\.4 s, not of a period of 0\.5 s"):
        Predictor(model, 0.5, place=nj.Place(model))


def file_of(path: Path, model, frame="", every=300.0):
    """A place, its file, and what is reported."""
    source, said = PeopleSource(frame), []
    place = open_place(path, model)
    return place, PlaceFile(path, place, source, said.append, every), said


def test_its_file_is_begun_kept_and_gone_on_with(model, tmp_path):
    path = tmp_path / "hall.npz"
    place, file, said = file_of(path, model, "map", every=0.0)
    file.show(EVENT, {})
    file.close()
    assert not path.exists()  # Nothing was watched.

    place.watch([[0.0, 0.0]], [1], 0.0)
    file.show(EVENT, {})
    file.close()
    assert nj.load_place(path, model).frame == "map"
    assert said == [f"{path}: the place is in the frame 'map'"]

    place, file, _ = file_of(path, model, "map")
    place.watch([[0.0, 0.0]], [1], 0.0)
    file.close()
    assert nj.load_place(path, model).seconds == pytest.approx(2 * PERIOD)


def test_a_memory_that_was_dropped_is_reported(model, tmp_path):
    path = tmp_path / "hall.npz"
    place, file, said = file_of(path, model)
    place.drops = 1
    file.show(EVENT, {})
    file.show(EVENT, {})
    assert len(said) == 1
    assert "was dropped" in said[0]
    predictor = predictor_at(place, model)
    assert "dropped" in Status(predictor, Analytics(predictor)).now()["place"]


def test_a_file_that_cannot_be_written_is_reported(model, tmp_path):
    path = tmp_path / "folder" / "hall.npz"
    place, file, said = file_of(path, model)
    place.watch([[0.0, 0.0]], [1], 0.0)
    (tmp_path / "folder").write_text("a file now")
    file.close()
    assert len(said) == 1
    assert str(path) in said[0]


WRITER = """
import sys, numpy as np
from neurosym_jax.models.place.place import write_place
contents = dict(np.load(sys.argv[1]))
while True:
    write_place(sys.argv[2], contents)
    print(flush=True)
"""


def test_a_killed_process_leaves_a_whole_file(model, taught, tmp_path):
    first, path = tmp_path / "first.npz", tmp_path / "hall.npz"
    taught[0].place.save(first)
    arguments = [sys.executable, "-c", WRITER, str(first), str(path)]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        # Amid a write: its temporary file is there.
        while len(os.listdir(tmp_path)) < 3:
            pass
        process.send_signal(signal.SIGKILL)
    assert nj.load_place(path, model).scored == taught[0].place.scored


@pytest.fixture
def options(tmp_path):
    """Options of a replay with a place in the frame "map"."""
    name = Path("sgan_zara1_8")
    place = nj.Place(nj.load_model(name), frame="map", moments=10)
    place.save(tmp_path / "hall.npz")

    def make(recording: Path, **more):
        return replay.Options(
            recording=(recording,), model=(name,), place=tmp_path / "hall.npz", **more
        )

    return make


def test_another_frame_is_another_place(options, tmp_path):
    bag = write_people(tmp_path / "walk.bag", walkers(1.0))
    with pytest.raises(InputError, match="'map', not --fixed-frame odom: another"):
        options(bag, fixed_frame="odom").source(print)

    # What comes in "odom" is taken to "map" by /tf, or left out with a message.
    said: list[str] = []
    source = options(bag).source(said.append, recorded=True)
    assert not list(read_frames(bag, source=source))
    assert source.refused["no transform"] > 0
    assert "people cannot be taken to 'map'" in said[0]

    table = tmp_path / "walk.txt"
    table.write_text("0 1 0.0 0.0\n10 1 0.4 0.0\n")
    with pytest.raises(InputError, match="--fixed-frame map says so"):
        options(table).source(print)
    assert options(table, fixed_frame="map").source(print).frame_id == "map"


def test_what_is_no_place_is_refused(model, tmp_path):
    path = tmp_path / "hall.npz"
    path.write_text("no place")
    with pytest.raises(InputError, match="a file of a place"):
        open_place(path, model)
    with pytest.raises(InputError):
        open_place(tmp_path, model)
