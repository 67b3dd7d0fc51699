"""Whatever a copy is called and wherever its origin is, it is found; other people are not."""

import dataclasses

import numpy as np
import pytest

from neurosym_jax.data import cut_windows, open_source
from neurosym_jax.data.tracks import make_tracks
from neurosym_jax.data.windows import (
    fingerprint,
    is_fingerprint,
    seen_before,
    shared_shapes,
)
from neurosym_jax.errors import InputWarning
from neurosym_jax.evaluation import compare

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
    assert len(seen) <= 4096
    for scene in benchmark.scenes:
        result, looked = seen_before(
            seen, cut_windows(benchmark.recordings(scene), 8, 12)
        )
        assert looked > 10
        assert result == 0 if scene == "zara1" else result > 0.4 * looked
    validation = cut_windows(benchmark.recordings("zara1", "val"), 8, 8)
    assert shared_shapes(validation, learned)[0] == 0


def test_a_copy_is_found(benchmark, learned):
    """Shifted, with other ids and another name, of a half; fewer where it is rounded."""
    (tracks,) = benchmark.recordings("zara2")
    part = tracks.with_ids(1000 - tracks.id).take(
        tracks.stamp < np.median(tracks.stamp)
    )
    moved = dataclasses.replace(
        part, recording="mine", position=part.position + 431234.5
    )
    rounded = dataclasses.replace(tracks, position=tracks.position.round(3))
    for copy, share in ((moved, 0.6), (rounded, 0.2)):
        result, looked = seen_before(fingerprint(learned), cut_windows([copy], 8, 12))
        assert result > share * looked


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
        InputWarning, match="mine: was trained on these people: 62 of 71 windows"
    ):
        test = compare.make_test(
            compare.TestSet("zara2", 8, 8), [("mine", model)], recordings["zara2"]
        )
    assert "trained on these people" in test.windows.reading[0].warnings[0]
    test = compare.make_test(
        compare.TestSet("zara1", 8, 8), [("mine", model)], recordings["zara1"]
    )
    assert test.windows.reading[0].warnings == ()
