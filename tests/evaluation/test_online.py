"""Online evaluation: scenes in the order of time, and nothing of what comes later."""

import dataclasses

import numpy as np
import pytest

import neurosym_jax as nj
from neurosym_jax.commands import evaluate
from neurosym_jax.data.tracks import make_tracks, on_grid
from neurosym_jax.data.windows import cut_windows, make_batches
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.compare import (
    Settings,
    Test,
    TestSet,
    evaluate_tests,
    with_tests,
)
from neurosym_jax.evaluation.online import recall_batches, watch_windows
from neurosym_jax.evaluation.tables import format_table, rows_frame
from neurosym_jax.models.baselines import ConstantVelocitySampled
from neurosym_jax.models.forecast import draw_batch
from tests.repository import slow

PERIOD = 0.4
OBSERVED, AHEAD = 5, 6


@pytest.fixture(scope="module")
def model():
    config = ConstantVelocitySampled.Config(obs_len=OBSERVED, pred_len=AHEAD)
    return nj.Model(config, {}, family="constant_velocity_sampled")


def corner(people=14, period=PERIOD, until=np.inf):
    """Rows of people who turn left after 4 m, one every 2 seconds, up to a time."""
    rows = []
    for person in range(people):
        rng = np.random.default_rng(person)
        speed, side = rng.normal(1.2, 0.1), rng.normal(0, 0.2)
        for step in range(round(7 / period)):
            time, way = person * 2.0 + step * period, speed * step * period
            place = (way, side) if way < 4 else (4 - side, way - 4)
            if time <= until:
                rows.append((time, person, *place))
    time, person, x, y = np.array(rows).T
    return make_tracks("corner", time, person, np.column_stack([x, y]))


def cut(tracks):
    return cut_windows([tracks], OBSERVED, AHEAD, min_agents=2)


@pytest.mark.parametrize("period", [slow(PERIOD), 0.3])
def test_the_future_of_a_file_changes_no_earlier_forecast_by_a_bit(model, period):
    """With steps of 0.3 s positions are interpolated, of which a half is known later."""
    whole, short = (
        on_grid(corner(people=11, period=period, until=until), PERIOD)
        for until in (np.inf, 18.0)
    )
    recalled, draws = [], []
    for tracks in (whole, short):
        windows = cut(tracks)
        recalled.append(watch_windows(model, windows, [tracks]))
        batches = make_batches(windows)
        memories = recall_batches(model, windows, batches, [tracks])
        scenes = {}
        for batch, memory in zip(batches, memories):
            arguments = (model.forecaster, model.params, batch.scene, 0, 20, memory)
            drawn = draw_batch(*arguments)
            for row, number in enumerate(batch.index.tolist()):
                if number >= 0:
                    people = int(windows.sizes[number])
                    scenes[number] = drawn[:, row, :people]
        draws.append(scenes)
    assert 10 < len(recalled[1]) < len(recalled[0])
    for number, scene in enumerate(recalled[1]):
        assert np.array_equal(scene.future, recalled[0][number].future)
        assert np.array_equal(scene.share, recalled[0][number].share)
        assert np.array_equal(draws[1][number], draws[0][number])
    assert max(scene.share.sum(0).max() for scene in recalled[1]) > 0.2


def test_nothing_is_recalled_before_something_is_over(model):
    tracks = corner()
    windows = cut(tracks)
    stamps = windows.stamp
    for scene, stamp in zip(watch_windows(model, windows, [tracks]), stamps):
        # The first moment has four steps, and 12 that follow.
        if stamp < (3 + AHEAD) * PERIOD - 1e-6:
            assert not scene.share.any()


@pytest.mark.slow
def test_each_recording_is_a_place_of_its_own(model):
    first, second = corner(), corner(people=8)
    both = cut_windows([first, second], OBSERVED, AHEAD, min_agents=2)
    alone = watch_windows(model, cut(second), [second])
    together = watch_windows(model, both, [first, second])[-len(alone) :]
    for one, other in zip(alone, together):
        assert np.array_equal(one.share, other.share)


@pytest.mark.slow
def test_a_file_of_the_place_is_where_it_begins(model, tmp_path):
    tracks = corner()
    place = nj.Place(model)
    place.watch_tracks(tracks)
    place.save(tmp_path / "corner.npz")
    windows = cut(corner(people=6))
    fresh, taught = (
        watch_windows(model, windows, [corner(people=6)], file)
        for file in (None, tmp_path / "corner.npz")
    )
    assert taught[0].share.sum() > 4 * fresh[0].share.sum()


def test_rows_with_and_without_the_memory(model, tmp_path):
    tracks = corner(people=7)
    test_set = TestSet("corner", OBSERVED, AHEAD)
    test = Test(test_set, [("mine", model)], cut(tracks), recordings=[tracks])
    names = ("joint_ade", "energy_score", "person_energy")
    settings = Settings(metrics=names, online=True)
    results = list(evaluate_tests([test], settings))
    alone, online = (result.row for result in results)
    assert online["model"] == f"{alone['model']}, online"
    for name in names:
        assert online[name] < 0.9 * alone[name]
    # One knows more than the other: they are not tested against each other.
    tested = with_tests(results)
    assert {row[f"{name}_p"] for row in tested for name in names} == {None}
    table = format_table(rows_frame(tested), width=120)
    assert "online: sees who was there before, and is compared with none" in table
    assert "significantly" not in table
    place = nj.Place(model)
    place.watch_tracks(tracks)
    place.save(tmp_path / "corner.npz")
    settings = dataclasses.replace(settings, place=tmp_path / "corner.npz")
    _, taught = (result.row for result in evaluate_tests([test], settings))
    assert taught["energy_score"] < online["energy_score"]


def test_it_is_refused_where_time_is_unknown(model):
    with pytest.raises(InputError, match="time is known"):
        watch_windows(model, cut(corner(people=4)), [])
    options = evaluate.Options(forecasts=("saved.npz",), online=True)
    with pytest.raises(InputError, match="time is known"):
        evaluate._validate(options)
    options = evaluate.Options(place="corner.npz")
    with pytest.raises(InputError, match="--place"):
        evaluate._validate(options)
