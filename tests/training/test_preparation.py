"""One preparation of data: clock, lengths, parts for validation, folds, and what was seen."""

import contextlib
import dataclasses

import numpy as np
import polars as pl
import pytest

import neurosym_jax as nj
from neurosym_jax.data.tables import ReadOptions
from neurosym_jax.data.tracks import make_tracks
from neurosym_jax.data.windows import fingerprint, seen_before, shared_shapes
from neurosym_jax.errors import InputError
from neurosym_jax.models.anchors.network import AnchorTableConfig
from neurosym_jax.scene import scene_identity
from neurosym_jax.training.preparation import describe_parts, prepare
from neurosym_jax.training.recipe import Recipe

CONFIG, RECIPE = AnchorTableConfig(4, 4), Recipe()
WINDOW = 8 * 0.4


def walk(name, seconds, people=4, period=0.4, decimals=4, noise=0.4):
    """People who walk about, all of them all the time."""
    rng, steps = np.random.default_rng([*map(ord, name)]), round(seconds / period)
    pace = rng.normal(1.0, noise, (people, 1, 2)) * period
    moves = pace + rng.normal(0, noise * period, (people, steps, 2))
    position = (rng.uniform(-5, 5, (people, 1, 2)) + moves.cumsum(1)).round(decimals)
    stamp = np.tile(np.arange(steps) * period, people)
    return make_tracks(
        name, stamp, np.repeat(np.arange(people), steps), position.reshape(-1, 2)
    )


def times(windows):
    """[S] seconds of the first and of the last step of each window."""
    return windows.stamp - 3 * 0.4, windows.stamp + 4 * 0.4


def test_other_rates_are_resampled_to_the_steps_of_the_config():
    """Point 1: 25 Hz would train at 0.04 s steps, and 10 Hz beside 2.5 Hz was accepted."""
    learned, validated = prepare(
        CONFIG, RECIPE, walk("fast", 40, period=0.04), walk("slow", 40, period=0.1)
    )
    assert learned.period == validated.period == 0.4
    steps = np.linalg.norm(np.diff(learned.position, axis=1), axis=-1)
    assert 0.3 < steps.mean() < 0.9
    slower, _ = prepare(dataclasses.replace(CONFIG, period=0.8), RECIPE, walk("a", 80))
    assert slower.period == 0.8


def test_a_recording_has_frames_of_its_own(tmp_path):
    """Point 1: one --fps for files of 10 and of 25 frames a second."""
    for name, rate in (("ten", 10), ("quad", 25)):
        tracks = walk(name, 40, period=1 / rate)
        frame = np.rint(tracks.stamp * rate).astype(int)
        table = {"frame": frame, "id": tracks.id, "x": tracks.position[:, 0]}
        pl.DataFrame(table | {"y": tracks.position[:, 1]}).write_csv(
            tmp_path / f"{name}.csv"
        )
    read = ReadOptions(fps="ten=10,quad=25")
    learned, _ = prepare(CONFIG, RECIPE, tmp_path, read=read)
    for reading in learned.reading:
        own = learned.identity[:, 0] == scene_identity(reading.recording, 0)[0]
        seconds = np.ptp(learned.stamp[own])
        assert seconds == pytest.approx(40 * 0.8 - 3 * WINDOW, abs=3)
    for wrong in ("ten=0", "ten=fast", -1.0, "nan"):
        with pytest.raises(InputError, match="fps must be positive"):
            ReadOptions(fps=wrong)


@pytest.mark.parametrize(
    ("lengths", "message"),
    [
        ((3, 4), r"windows of 3 \+ 4 steps do not fit a config of 4 \+ 4"),
        ((4, 6), r"windows of 4 \+ 6 steps do not fit a config of 4 \+ 4"),
    ],
)
def test_windows_of_other_lengths_are_refused(lengths, message):
    """Point 1: a network of 8 + 8 that learned from 6 + 8; a bare ValueError of 8 + 12."""
    good = nj.windows_from(walk("a", 40), 4, 4)
    for parts in (
        (nj.windows_from(walk("b", 40), *lengths), good),
        (good, nj.windows_from(walk("b", 40), *lengths)),
    ):
        with pytest.raises(InputError, match=message):
            prepare(CONFIG, RECIPE, *parts)
    other = nj.windows_from(walk("b", 40), 4, 4, period=0.2)
    with pytest.raises(InputError, match=r"steps of 0\.2 s and the config of 0\.4 s"):
        prepare(CONFIG, RECIPE, good, other)


def test_the_same_people_are_refused_for_both_unless_that_is_meant():
    """Point 1, 4: from Python too; by a waiver as other guards."""
    tracks = walk("a", 60)
    windows = nj.windows_from(tracks, 4, 4)
    for parts in (
        (tracks, tracks),
        (windows, windows),
        (windows, dataclasses.replace(tracks, recording="b")),
    ):
        with pytest.raises(InputError, match="that is what the model is validated on"):
            prepare(CONFIG, RECIPE, *parts)
        prepare(CONFIG, RECIPE, *parts, read=ReadOptions(allow=("seen",)))
    with pytest.raises(InputError, match="that is what the model is tested on"):
        prepare(CONFIG, RECIPE, tracks, walk("c", 60), tested=[tracks])
    with pytest.raises(
        InputError, match=r"the initial model learned from .* validated on"
    ):
        prepare(CONFIG, RECIPE, walk("c", 60), tracks, seen=fingerprint(windows))
    # Of long recordings a fingerprint keeps few shapes: one that is found is enough.
    long = walk("a", 2000)
    part = dataclasses.replace(long.take(long.stamp < 12), recording="d")
    seen = fingerprint(nj.windows_from(long, 4, 4))
    assert 1 <= seen_before(seen, nj.windows_from(part, 4, 4))[0] <= 6
    with pytest.raises(
        InputError, match=r"the initial model learned from .* validated on"
    ):
        prepare(CONFIG, RECIPE, walk("c", 60), part, seen=seen)


def test_what_is_alike_by_chance_is_no_leak():
    """Point 4: positions rounded to 10 cm are alike by chance, and a copy of them is found."""
    learned, other = (
        walk(name, 100, people=40, decimals=1, noise=0.08) for name in "ab"
    )
    shared_count, total = shared_shapes(
        *(nj.windows_from(tracks, 4, 4) for tracks in (other, learned))
    )
    assert 0.02 * total < shared_count < 0.3 * total
    prepare(CONFIG, RECIPE, learned, other)
    copy = dataclasses.replace(learned.take(learned.stamp < 50), recording="copy")
    with pytest.raises(InputError, match=r"has \d+, \d+ by chance, of the \d+ shapes"):
        prepare(CONFIG, RECIPE, learned, copy)


@pytest.mark.parametrize(("steps", "leak"), [(10, False), (80, True)])
def test_up_to_one_shape_of_a_hundred_is_no_leak(steps, leak):
    """A fifth person who walks as somebody in the training data did: 3 or 73 of 4,000 windows."""
    learned, other = walk("a", 400), walk("b", 400)
    copied = learned.take((learned.id == 0) & (learned.stamp < 0.4 * steps - 0.1))
    id = np.concatenate([other.id, np.full(len(copied.id), 4)])
    stamp, position = (
        np.concatenate([getattr(other, name), getattr(copied, name)])
        for name in ("stamp", "position")
    )
    mixed = make_tracks("mixed", stamp, id, position)
    if not leak:
        prepare(CONFIG, RECIPE, learned, mixed)
        return
    with pytest.raises(InputError, match="the training data has 73 of the 4043 shapes"):
        prepare(CONFIG, RECIPE, learned, mixed)


@pytest.mark.parametrize(("steps", "shared"), [(8, 1), (9, 2)])
def test_one_shape_of_a_short_recording_is_chance_and_two_are_a_leak(steps, shared):
    """Fine-tuning on tracks of a minute was refused for one shape of 27."""
    learned, other = walk("a", 400), walk("b", 12)
    copied = learned.take((learned.id == 0) & (learned.stamp < 0.4 * steps - 0.1))
    other = dataclasses.replace(other, recording="other")
    copied = dataclasses.replace(copied, recording="copied")
    validation = nj.windows_from([other, copied], 4, 4, min_agents=1)
    count, total = shared_shapes(validation, nj.windows_from(learned, 4, 4))
    assert count == shared
    assert total < 100
    refused = pytest.raises(InputError, match="that is what the model is validated on")
    with refused if shared > 1 else contextlib.nullcontext():
        prepare(CONFIG, RECIPE, learned, validation)


def test_the_last_windows_validate_a_window_apart():
    learned, validated = prepare(CONFIG, RECIPE, [walk("a", 100), walk("b", 100)])
    for name in ("a", "b"):
        digest = scene_identity(name, 0)[0]
        ends = times(learned)[1][learned.identity[:, 0] == digest]
        begins = times(validated)[0][validated.identity[:, 0] == digest]
        assert begins.min() - ends.max() == pytest.approx(WINDOW + 0.4, abs=0.41)
        assert begins.min() > ends.max() + WINDOW - 1e-6
        assert len(begins) == pytest.approx(0.2 * 243, abs=1)
    text = describe_parts(learned, validated)
    assert f"  a: {learned.scenes // 2} / {validated.scenes // 2}" in text


def test_short_recordings_are_divided_whole_and_one_by_time():
    """Point 5: what is shorter than five windows gave no validation and lost its end."""
    short = [walk(f"r{at}", 4 * WINDOW) for at in range(6)]
    learned, validated = prepare(CONFIG, RECIPE, short)
    assert [reading.recording for reading in validated.reading] == ["r4"]
    assert [reading.recording for reading in learned.reading] == [
        "r0",
        "r1",
        "r2",
        "r3",
        "r5",
    ]
    assert learned.scenes == 5 * validated.scenes == 5 * 25
    learned, validated = prepare(CONFIG, RECIPE, short[:2])
    assert (learned.scenes, validated.scenes) == (25, 25)
    learned, validated = prepare(CONFIG, RECIPE, short[0])
    assert times(learned)[1].max() < times(validated)[0].min()
    assert (learned.scenes, validated.scenes) == (13, 5)
    with pytest.raises(InputError, match=r"windows last 4\.8 s, and 6\.4 s are needed"):
        prepare(CONFIG, RECIPE, walk("tiny", 1.5 * WINDOW))


def test_a_long_recording_beside_short_ones_validates():
    learned, validated = prepare(
        CONFIG, RECIPE, [walk("short", 2 * WINDOW), walk("long", 200)]
    )
    assert {reading.recording for reading in validated.reading} == {"long"}
    assert {reading.recording for reading in learned.reading} == {"short", "long"}


def test_folds_cover_all_once_and_never_what_is_learned():
    """Point 6: one's own k folds, of recordings or of time."""
    many = [walk(f"r{at}", 30) for at in range(6)]
    folds = []
    for number in range(1, 4):
        learned, validated = prepare(CONFIG, RECIPE, many, fold=f"{number}/3")
        names = [reading.recording for reading in validated.reading]
        assert not {*names} & {reading.recording for reading in learned.reading}
        folds += names
    assert sorted(folds) == [f"r{at}" for at in range(6)]

    recording, begins = walk("one", 100), []
    for number in range(1, 5):
        learned, validated = prepare(CONFIG, RECIPE, recording, fold=f"{number}/4")
        begins += [*times(validated)[0]]
        after = times(learned)[0][:, None] - times(validated)[1]
        before = times(validated)[0] - times(learned)[1][:, None]
        assert np.maximum(after, before).min() > WINDOW - 1e-6
        assert learned.scenes > 2 * validated.scenes
    assert np.sort(begins) == pytest.approx(
        np.sort(times(nj.windows_from(recording, 4, 4))[0])
    )
    for fold in ("0/3", "4/3", "1", "a/b", "1/1"):
        with pytest.raises(InputError, match=r"fold: K/N, such as 1/5"):
            prepare(CONFIG, RECIPE, recording, fold=fold)
    with pytest.raises(InputError, match="has no effect where validation is given"):
        prepare(CONFIG, RECIPE, recording, walk("two", 100), fold="1/3")
    with pytest.raises(InputError, match="windows cannot be divided"):
        prepare(CONFIG, RECIPE, nj.windows_from(recording, 4, 4))


def test_one_person_is_enough_where_the_network_allows_it():
    """Point 4: validation wanted two people always."""
    alone, recipe = (
        walk("alone", 100, people=1),
        dataclasses.replace(RECIPE, min_agents=1),
    )
    learned, validated = prepare(CONFIG, recipe, alone)
    assert set(learned.sizes) == set(validated.sizes) == {1}
    with pytest.raises(
        InputError, match=r"at least 2 people.*; min_agents=1 in the recipe .* learns"
    ):
        prepare(CONFIG, RECIPE, alone)
    mixed = [alone, walk("pair", 100, people=2)]
    assert set(prepare(CONFIG, recipe, mixed)[1].sizes) == {2}
