"""A place that is watched: what it learns, what it may not know, and its files."""

import re

import numpy as np
import pytest

import neurosym_jax as nj
from neurosym_jax.data.tracks import make_tracks
from neurosym_jax.errors import InputError
from neurosym_jax.models.baselines import ConstantVelocitySampled
from neurosym_jax.models.place.place import steps_of
from neurosym_jax.models.place.stream import Steps
from neurosym_jax.scene import make_scene
from tests.repository import exhaustive

PERIOD = 0.4


@pytest.fixture(scope="module")
def model():
    """Quick to compile, and wrong wherever people turn."""
    config = ConstantVelocitySampled.Config(obs_len=8, pred_len=12)
    return nj.Model(config, {}, family="constant_velocity_sampled")


def corner(time, seed=0, shift=(0.0, 0.0)):
    """[2] metres: someone who walks along a corridor and turns left after 8 m."""
    rng = np.random.default_rng(seed)
    speed, side = rng.normal(1.2, 0.1), rng.normal(0, 0.2)
    way = speed * time
    place = [way, side] if way < 8 else [8 - side, way - 8]
    return np.array(place) + shift


def crowd(people, every=4.0, seconds=14.0, **place):
    """Rows of a recording of a corner, at which somebody new arrives `every` seconds."""
    rows = []
    for person in range(people):
        for step in range(round(seconds / PERIOD)):
            time = person * every + step * PERIOD
            rows.append((time, person, *corner(step * PERIOD, person, **place)))
    time, person, x, y = np.array(rows).T
    return make_tracks("corner", time, person, np.column_stack([x, y]))


@pytest.fixture(scope="module")
def watched(model):
    place = nj.Place(model, frame="map")
    place.watch_tracks(crowd(30))
    return place


def window(seed, end, **place):
    """[1, 8, 2] somebody new, 8 steps before `end` seconds."""
    times = end - PERIOD * np.arange(8)[::-1]
    return np.array([[corner(time, seed, **place) for time in times]])


def test_a_corner_is_learned(watched):
    people, network, used = watched.scored
    assert people > 300
    assert used < 0.85 * network
    assert watched.shares["network"] < 0.4


def test_errors_lead_from_what_was_expected_to_what_came(watched):
    arrays = watched.contents()
    error = arrays["memory_error"]
    moments = arrays["memory_person"] >= 0
    was_forecast = moments & np.isfinite(error).all(axis=(1, 2))
    # Nobody had the whole window after seven steps.
    assert 0.8 < was_forecast.sum() / moments.sum() < 1
    velocity, earlier = np.split(arrays["memory_moment"][:, 2:], 2, axis=1)
    # Of who did not turn before, all forecasts go straight on.
    walked_straight = was_forecast & np.isclose(velocity, earlier, atol=1e-3).all(
        axis=1
    )
    onward = arrays["memory_onward"][walked_straight]
    time = PERIOD * np.arange(1, 13)[:, None]
    straight = velocity[walked_straight, None] * time
    assert np.abs(onward - straight).max() > 4  # They come to the corner.
    expected = onward - error[walked_straight]
    np.testing.assert_allclose(expected, straight, atol=0.9)


def test_forecasts_turn_where_people_turn(model, watched):
    observed = window(999, 6.0)
    future = np.array([corner(6.0 + PERIOD * step, 999) for step in range(1, 13)])
    alone = nj.predict_distribution(model, observed)
    taught = nj.predict_distribution(model, observed, place=watched)
    assert alone.shape == taught.shape == (200, 1, 12, 2)

    def error(draws):
        return np.linalg.norm(draws[:, 0] - future, axis=-1).mean()

    assert error(taught) < 0.6 * error(alone)


@pytest.mark.slow
def test_the_best_of_twenty_samples_turns_and_the_most_probable_stays():
    model = nj.load_model("anchors_general_12")
    place = nj.Place(model)
    place.watch_tracks(crowd(10))
    observed = window(999, 6.0)
    future = np.array([corner(6.0 + PERIOD * step, 999) for step in range(1, 13)])
    alone, probability = nj.predict_representatives(model, observed)
    taught, same = nj.predict_representatives(model, observed, place=place)

    def best(samples):
        return np.linalg.norm(samples[:, 0] - future, axis=-1).mean(axis=-1).min()

    assert best(taught) < 0.9 * best(alone)
    assert np.array_equal(probability, same)
    central = probability.argmax()
    np.testing.assert_allclose(taught[central], alone[central], atol=1e-5)
    kept = [
        np.abs(alone - sample).max(axis=(1, 2, 3)).min() < 1e-5 for sample in taught
    ]
    assert 10 <= sum(kept) < 20
    assert np.array_equal(nj.predict(model, observed, place=place), taught)


def test_elsewhere_the_forecast_is_the_models_own_direction(model, watched):
    observed = window(999, 6.0, shift=(300.0, 0.0))
    draws = nj.predict_distribution(model, observed, place=watched)
    assert np.isfinite(draws).all()
    assert draws[..., 0].min() > 300


def test_a_place_without_a_memory_changes_nothing(model):
    observed = window(1, 5.0)
    alone = nj.predict_distribution(model, observed)
    assert (
        nj.predict_distribution(model, observed, place=nj.Place(model)) == alone
    ).all()


@pytest.mark.slow
def test_anchors_take_their_share_and_without_memory_none():
    model = nj.load_model("anchors_general_12")
    place = nj.Place(model)
    observed = np.concatenate([window(1, 6.0), window(2, 6.0, shift=(0.0, 2.0))])
    alone = nj.predict_distribution(model, observed)
    empty = nj.predict_distribution(model, observed, place=place)
    assert empty.mean((0, 2)) == pytest.approx(alone.mean((0, 2)), abs=0.05)
    place.watch_tracks(crowd(10))
    taught = nj.predict_distribution(model, observed, place=place)
    turned = taught[:, 0, -1, 1] > 1.5
    assert place.scored.used < place.scored.network
    assert turned.mean() > (alone[:, 0, -1, 1] > 1.5).mean() + 0.2


def test_what_comes_later_changes_no_earlier_forecast(model):
    tracks = crowd(12)
    steps = steps_of(tracks, PERIOD)
    draws, places = [], []
    for kept in (len(steps), 60):
        place = nj.Place(model)
        place.begin()
        for step in steps[: min(kept, 60)]:
            place.watch_step(step)
        draws.append(nj.predict_distribution(model, window(5, 6.0), place=place))
        for step in steps[60:kept]:
            place.watch_step(step)
        places.append(place)
    assert (draws[0] == draws[1]).all()
    assert places[0].moments > places[1].moments


def test_nothing_is_remembered_before_it_is_over(model):
    """Seven steps tell the two velocities, and twelve what followed."""
    place = nj.Place(model)
    for step in range(19):
        assert place.moments == 0
        place.watch([[0.4 * step, 0.0]], [7], PERIOD * step)
    assert place.moments == 1


@pytest.mark.parametrize("rate", [2.5, 10, 7.3, 30])
def test_frames_of_any_rate_are_the_same_steps(rate):
    steps = Steps(PERIOD)
    given = []
    for frame in range(int(4 * rate)):
        time = 100 + frame / rate
        position = np.array([[1.3 * frame / rate, 5.0]])
        given += list(steps.push(time, np.array([3]), position))
    numbers = [step.number for step in given]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert len(given) >= int(4 / PERIOD) - 1
    for count, step in enumerate(given):
        assert step.time == pytest.approx(100 + PERIOD * count, abs=1e-3)
        assert step.position[0] == pytest.approx([1.3 * PERIOD * count, 5], abs=1e-2)


def test_a_pause_ends_tracks(model):
    place = nj.Place(model)
    for step in range(40):
        pause = 10.0 if step >= 10 else 0.0
        place.watch([[0.4 * step, 0.0]], [7], PERIOD * step + pause)
    # Without the pause all 40 steps were one track.
    assert place.scored.people == 30 - 8 + 1 - 12


def test_somebody_who_jumps_is_not_remembered(model):
    place = nj.Place(model)
    for step in range(40):
        jump = 30.0 if step >= 20 else 0.0
        place.watch([[0.4 * step + jump, 0.0]], [7], PERIOD * step)
    onward = np.asarray(place._memory.onward)
    assert 0 < np.abs(onward).max() < 6


@pytest.mark.parametrize("speed", [1.3, 6.0, 12.0])
def test_a_runner_is_remembered_as_a_walker_is(model, speed):
    """The guard against people who jump must not take speed for a jump."""
    place = nj.Place(model)
    for step in range(40):
        place.watch([[speed * PERIOD * step, 0.0]], [7], PERIOD * step)
    onward = np.asarray(place._memory.onward)
    assert np.abs(onward).max() == pytest.approx(12 * PERIOD * speed, rel=0.01)


@pytest.mark.parametrize("seed", [0, exhaustive(1), exhaustive(2)])
def test_broken_ids_cost_no_more_than_the_limit(model, seed):
    rng = np.random.default_rng(seed)
    place = nj.Place(model)
    for step in range(150):
        lanes = np.arange(5)[:, None] * [0, 1]
        walked = [corner(PERIOD * (step % 30), person) for person in range(5)]
        position = np.array(walked) + lanes
        ids = rng.permutation(5) if step % 9 == 0 else np.arange(5)
        place.watch(position, ids, PERIOD * step)
    assert place.scored.people > 50
    assert place.scored.used - place.scored.network <= place.limit


@pytest.fixture
def morning(model, watched, tmp_path):
    """A place where 30 people turned left, as it is the next day."""
    watched.save(tmp_path / "morning.npz")
    return nj.load_place(tmp_path / "morning.npz", model)


def brought(place, tracks):
    """Energy score while these are watched, as a part of that of the model alone."""
    before = place.scored
    place.watch_tracks(tracks)
    _people, network, used = np.subtract(place.scored, before)
    assert used - network <= 2 * place.limit
    return used / network


def mirrored(people):
    tracks = crowd(people)
    tracks.position[:, 1] *= -1
    return tracks


@pytest.mark.slow
@pytest.mark.parametrize("half_life", [60.0, np.inf])
def test_a_place_that_flips_at_noon_recovers(morning, half_life):
    morning.half_life = half_life
    assert brought(morning, mirrored(10)) < 0.95
    # What has faded may lose too little to be dropped.
    assert morning.drops in (0, 1)
    assert morning.drops or half_life < np.inf
    assert brought(morning, mirrored(6)) < 0.6
    assert morning.drops <= 1


def test_who_was_there_one_half_life_ago_counts_for_half(model):
    places = [nj.Place(model, half_life=half_life) for half_life in (48.0, np.inf)]
    for place in places:
        place.watch_tracks(crowd(4, every=0.0, seconds=7.6))
        for step in range(120):
            place.watch([], [], PERIOD * step)
    fading, lasting = (
        np.asarray(place._recall(window(0, 1.6), 1).weight).sum() for place in places
    )
    assert lasting > 0.5
    assert fading == pytest.approx(lasting / 2, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [90, 180, -90])
def test_a_camera_that_was_turned_costs_nothing(morning, degrees):
    """What people did elsewhere is not recalled, and is learned anew."""
    tracks = crowd(6)
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    tracks.position[:] = (tracks.position - [8, 0]) @ turn + [8, 0]
    assert brought(morning, tracks) < 0.9
    assert morning.drops == 0


@pytest.mark.slow
def test_a_place_that_stays_never_drops_its_memory(morning):
    """Nor does one where the memory brings nothing: people who walk straight, anywhere."""
    rng = np.random.default_rng(0)
    tracks = crowd(10)
    for person in range(10):
        rows = tracks.id == person
        way = np.arange(rows.sum())[:, None] * rng.normal(0, 0.4, 2)
        tracks.position[rows] = rng.normal(0, 10, 2) + way
    morning.watch_tracks(tracks)
    assert brought(morning, crowd(10)) < 0.6
    assert morning.drops == 0


@pytest.mark.slow
def test_people_who_go_anywhere_one_at_a_time_are_forecast_better_all_the_same(model):
    """One of them is enough to drop the memory, of a place that stays as it is."""
    rng = np.random.default_rng(9)
    rows = []
    for person in range(30):
        angle, speed = rng.uniform(-np.pi, np.pi), rng.normal(1.3, 0.2)
        for step in range(35):
            before, after = min(step, 10), max(step - 10, 0)
            way = np.array([before, 0]) + after * np.array(
                [np.cos(angle), np.sin(angle)]
            )
            time = 14 * person + PERIOD * step
            rows.append((time, person, *(PERIOD * speed * way)))
    time, person, x, y = np.array(rows).T
    place = nj.Place(model)
    place.watch_tracks(make_tracks("hall", time, person, np.column_stack([x, y])))
    assert place.drops > 0
    assert place.scored.used < 0.95 * place.scored.network


@pytest.mark.slow
def test_people_of_hotel_never_drop_a_memory(model, shared):
    place = nj.Place(model)
    place.watch_tracks(shared / "data" / "eth_ucy" / "all" / "biwi_hotel.txt")
    assert place.scored.used < 0.9 * place.scored.network
    assert place.drops == 0


@pytest.mark.parametrize("half_life", [0, -1.0, np.nan])
def test_a_half_life_is_positive(model, watched, half_life, tmp_path):
    with pytest.raises(InputError, match="half_life"):
        nj.Place(model, half_life=half_life)
    watched.save(tmp_path / "place.npz")
    with pytest.raises(InputError, match="half_life"):
        nj.load_place(tmp_path / "place.npz", model, half_life=half_life)


def test_a_file_has_all_that_was_learned(model, watched, tmp_path):
    watched.save(tmp_path / "corner.npz")
    loaded = nj.load_place(tmp_path / "corner.npz", model)
    observed = window(4, 6.0)
    draws = [
        nj.predict_distribution(model, observed, place=place)
        for place in (watched, loaded)
    ]
    assert (draws[0] == draws[1]).all()
    assert (loaded.frame, loaded.moments) == ("map", watched.moments)
    assert loaded.scored == watched.scored
    assert loaded.limit == watched.limit
    assert (loaded.drops, loaded.half_life) == (watched.drops, np.inf)
    assert loaded.change == watched.change
    loaded.watch_tracks(crowd(3))
    assert loaded.moments > watched.moments


def test_people_who_walk_are_forecast_with_their_own_shares(model):
    place = nj.Place(model)
    place.watch_tracks(crowd(12))
    alone, *recalled = np.eye(place._shares.shape[1])
    # Nothing is recalled for people who stand, and `near` alone for those who walk.
    place._shares = np.array([alone, recalled[0]])
    assert place.shares["near"] == 1  # Nobody stood.
    observed = window(40, 6.0)
    memory = place.recalled(observed, make_scene(observed), 2)
    assert np.asarray(memory.share.sum(axis=0)) == pytest.approx([1, 0])


def test_a_day_later_everything_can_be_forgotten(model):
    place = nj.Place(model)
    place.watch_tracks(crowd(6))
    before = place.moments
    place.forget(older_than=3600)
    assert place.moments == before
    place.forget(older_than=0)
    assert place.moments == 0
    with pytest.raises(InputError, match="older_than"):
        place.forget(older_than=-1)


@pytest.mark.slow
def test_map_coordinates_lose_nothing(model):
    """Five thousand kilometres from the origin a float32 resolves half a metre."""
    far = (5e6, -3e6)
    place = nj.Place(model)
    place.watch_tracks(crowd(8, shift=far))
    near = nj.Place(model)
    near.watch_tracks(crowd(8))
    assert place.scored == pytest.approx(near.scored, rel=1e-4)
    observed = window(50, 6.0, shift=far)
    draws = nj.predict_distribution(model, observed, place=place)
    assert np.abs(draws - far).max() < 100


@pytest.mark.parametrize(
    ("positions", "ids", "time", "reason"),
    [
        ([[0, 0, 0]], [1], 0, "positions"),
        ([[0, 0], [1, 1]], [1], 0, "ids"),
        ([[0, 0], [1, 1]], [1, 1], 0, "twice"),
        ([[0, np.nan]], [1], 0, "finite"),
        ([[0, 0]], [1.5], 0, "whole"),
        ([[0, 0]], [1], np.inf, "time"),
    ],
)
def test_wrong_frames_are_refused(model, positions, ids, time, reason):
    with pytest.raises(InputError, match=reason):
        nj.Place(model).watch(positions, ids, time)


def test_time_goes_on_and_nobody_may_be_there(model):
    place = nj.Place(model)
    place.watch([], [], 1.0)
    place.watch(np.zeros((0, 2)), [], 1.4)
    place.watch([[0.0, 0.0]], [1], 1.8)
    with pytest.raises(InputError, match="not after"):
        place.watch([[0.0, 0.0]], [1], 1.8)
    assert "minutes" in repr(place)


def test_another_model_and_another_file_are_refused(model, watched, tmp_path):
    other = nj.Model(model.config, {}, family="constant_velocity_sampled")
    with pytest.raises(InputError, match="another model"):
        nj.predict_distribution(other, window(0, 5.0), place=watched)
    shorter = ConstantVelocitySampled.Config(obs_len=8, pred_len=8)
    short = nj.Model(shorter, {}, family="constant_velocity_sampled")
    watched.save(tmp_path / "place.npz")
    with pytest.raises(InputError, match="another model"):
        nj.load_place(tmp_path / "place.npz", short)
    (tmp_path / "noise.npz").write_bytes(b"PK nothing")
    with pytest.raises(InputError, match="cannot be read as a file of a place"):
        nj.load_place(tmp_path / "noise.npz", model)
    with pytest.raises(InputError, match="cannot be read: No such file"):
        nj.load_place(tmp_path / "absent.npz", model)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("memory_onward", "memory_onward must be"),
        ("shares", "shares must be [2, 8] float"),
        ("ledger_error", "ledger_error must be [2, 8] float"),
    ],
)
def test_a_file_with_arrays_of_another_shape_is_refused(
    model, watched, tmp_path, name, reason
):
    watched.save(tmp_path / "place.npz")
    with np.load(tmp_path / "place.npz") as stored:
        arrays = dict(stored)
    np.savez(tmp_path / "cut.npz", **{**arrays, name: arrays[name][1:]})
    with pytest.raises(InputError, match=re.escape(reason)):
        nj.load_place(tmp_path / "cut.npz", model)
    del arrays[name]
    np.savez(tmp_path / "without.npz", **arrays)
    with pytest.raises(InputError, match="cannot be read as a file of a place"):
        nj.load_place(tmp_path / "without.npz", model)
