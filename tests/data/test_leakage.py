"""Whatever a copy is called and wherever its origin is, it is found; other people are not."""

import dataclasses
import warnings

import numpy as np
import polars as pl
import pytest

from neurosym_jax.data import cut_windows, open_source
from neurosym_jax.data.recordings import read_any
from neurosym_jax.data.tables import ReadOptions
from neurosym_jax.data.tracks import make_tracks, resample
from neurosym_jax.data.windows import (
    fingerprint,
    is_fingerprint,
    seen_before,
    shared_shapes,
)
from neurosym_jax.errors import InputWarning
from neurosym_jax.evaluation import compare
from neurosym_jax.evaluation.tables import format_table, rows_frame
from neurosym_jax.models.disk import load_model

pytestmark = pytest.mark.filterwarnings("ignore:.*needs eth_stride=6")


@pytest.fixture(scope="module")
def benchmark(shared):
    return open_source(shared / "data/eth_ucy")


@pytest.fixture(scope="module")
def learned(benchmark):
    return cut_windows(benchmark.recordings("zara1", "train"), 8, 8)


def test_no_test_set_is_in_its_training(benchmark, learned):
    """Of 19 that are looked for in zara1; of the others, the parts for training are found."""
    seen = fingerprint(learned)
    assert is_fingerprint(seen)
    assert not any(map(is_fingerprint, (None, 3, "a", "a" * 4104, "====", "aaaa\naaa")))
    assert len(seen) <= 4098
    for scene in benchmark.scenes:
        result, looked = seen_before(
            seen, cut_windows(benchmark.recordings(scene), 8, 12)
        )
        assert looked > 5
        assert result == 0 if scene == "zara1" else result > 0.4 * looked
    validation = cut_windows(benchmark.recordings("zara1", "val"), 8, 8)
    assert shared_shapes(validation, learned)[0] == 0


@pytest.mark.parametrize(
    ("unit", "decimals", "share"),
    [("m", 4, 0.6), ("m", 2, 0.4), ("mm", 0, 0.6), ("cm", 0, 0.4)],
)
def test_a_copy_is_found(benchmark, learned, tmp_path, unit, decimals, share):
    """Shifted, with other ids and another name, of a half."""
    scale = {"m": 1, "cm": 100, "mm": 1000}[unit]
    (tracks,) = benchmark.recordings("zara2")
    part = tracks.take(tracks.stamp < np.median(tracks.stamp))
    x, y = (scale * (part.position + 431.56785)).round(decimals).T
    table = {"seconds": part.stamp, "id": 1000 - part.id, "x": x, "y": y}
    pl.DataFrame(table).write_csv(tmp_path / "mine.csv")
    (copy,) = read_any(tmp_path / "mine.csv", ReadOptions(unit=unit))
    hits, looked = seen_before(fingerprint(learned), cut_windows([copy], 8, 12))
    assert looked > 20
    assert hits > share * looked


@pytest.mark.parametrize("later", [0.1, 0.2, 0.3])
def test_a_copy_between_the_steps_is_found(benchmark, learned, later):
    """Interpolated between annotations; people who were not learned are not found so either."""
    seen = fingerprint(learned)
    for scene in ("zara1", "zara2"):
        (tracks,) = benchmark.recordings(scene)
        copy = resample(tracks, 0.4, start=float(tracks.stamp.min()) + later)
        hits, looked = seen_before(seen, cut_windows([copy], 8, 12))
        assert hits == 0 if scene == "zara1" else hits > 0.2 * looked


def test_short_windows_have_shapes_too(benchmark):
    own = benchmark.recordings("zara2", "train")
    seen = fingerprint(cut_windows(own, 5, 4))
    rounded = []
    for tracks in own:
        position = tracks.position.round(3)
        rounded.append(dataclasses.replace(tracks, position=position))
    hits, looked = seen_before(seen, cut_windows(rounded, 5, 4))
    assert hits > 0.5 * looked
    others = cut_windows(benchmark.recordings("zara2"), 5, 4)
    assert seen_before(seen, others)[0] == 0


def test_what_ships_has_the_shapes_of_its_training(learned):
    assert load_model("sgan_zara1_8").seen == fingerprint(learned)


def test_every_model_that_has_seen_the_people_is_named():
    stamp, person = (part.ravel() for part in np.mgrid[0:30, 0:3])
    xy = np.stack([0.4 * stamp + 0.1 * np.sin(stamp * person), person], axis=1)
    tracks = make_tracks("mine", 0.4 * stamp, person, xy)
    seen = fingerprint(cut_windows([tracks], 8, 8))
    model = dataclasses.replace(compare.baseline("constant_velocity", 8, 8), seen=seen)
    entries = [("first", model), ("second", model)]
    with pytest.warns(InputWarning, match="trained on these people") as caught:
        test = compare.make_test(compare.TestSet("mine", 8, 8), entries, [tracks])
    said = [str(warning.message).partition(":")[0] for warning in caught]
    assert said == ["first", "second"]
    kept = [line.partition(":")[0] for line in test.windows.reading[0].warnings]
    assert kept == ["first", "second"]


def test_an_evaluation_says_so(benchmark, learned):
    model = dataclasses.replace(
        compare.baseline("constant_velocity", 8, 8), seen=fingerprint(learned)
    )
    recordings = {scene: benchmark.recordings(scene) for scene in ("zara1", "zara2")}
    with pytest.warns(
        InputWarning, match="mine: was trained on these people: 67 of 84 windows"
    ):
        test = compare.make_test(
            compare.TestSet("zara2", 8, 8), [("mine", model)], recordings["zara2"]
        )
    assert "trained on these people" in test.windows.reading[0].warnings[0]
    test = compare.make_test(
        compare.TestSet("zara1", 8, 8), [("mine", model)], recordings["zara1"]
    )
    assert test.windows.reading[0].warnings == ()


def test_who_learned_the_people_is_compared_with_nobody():
    """Constant velocity follows these people exactly: it had the star."""
    stamp, person = (part.ravel() for part in np.mgrid[0:400, 0:3])
    xy = np.stack([0.4 * stamp * (1 + 0.1 * person), 3.0 * person], axis=1)
    xy += np.random.default_rng(0).normal(0, 0.03, xy.shape)
    tracks = make_tracks("mine", 0.4 * stamp, person, xy)
    seen = fingerprint(cut_windows([tracks], 8, 8))
    best = compare.baseline("constant_velocity", 8, 8)
    other = compare.baseline("constant_velocity_sampled", 8, 8)
    for learned in (False, True):
        model = dataclasses.replace(best, seen=seen if learned else "")
        entries = [("best", model), (None, other)]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", InputWarning)
            test = compare.make_test(compare.TestSet("mine", 8, 8), entries, [tracks])
        settings = compare.Settings(samples=1, metrics=("joint_ade",))
        rows = compare.with_tests([*compare.evaluate_tests([test], settings)])
        assert [row["learned"] for row in rows] == [learned, False]
        assert (rows[1]["joint_ade_p"] is None) == learned
        text = format_table(rows_frame(rows))
        line = next(line for line in text.splitlines() if "velocity" in line)
        assert ("*" in line, "(learned)" in line) == (not learned, learned)
        assert ("(learned): was trained on these people" in text) is learned
