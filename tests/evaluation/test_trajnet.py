"""TrajNet++ files: identity is kept both ways, and the evaluator's rules hold."""

import itertools
import json

import numpy as np
import pytest

import neurosym_jax as nj
from neurosym_jax.data.readers.trajnet import read_predictions, read_scenes
from neurosym_jax.data.tables import GUARDS
from neurosym_jax.data.tracks import make_tracks
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.compare import TestSet as Case
from neurosym_jax.evaluation.compare import baseline, make_test
from neurosym_jax.evaluation.saved_forecasts import save_forecasts

PEOPLE = {5: (0, 30), 7: (0, 30), 9: (6, 30), 12: (0, 4), 13: (25, 30)}
"""First and last step at which each person is seen."""


@pytest.fixture(scope="module")
def official(tmp_path_factory):
    """A recording that lists two scenes of 9 + 12 steps, 20 frames apart."""
    path = tmp_path_factory.mktemp("trajnet") / "hall.ndjson"
    scenes = [
        {"id": 40, "p": 5, "s": 1000, "e": 1400, "fps": 2.5, "tag": [3, [1, 3]]},
        {"id": 41, "p": 7, "s": 1100, "e": 1500, "fps": 2.5, "tag": [2, []]},
    ]
    rows = [{"scene": scene} for scene in scenes]
    for person, (first, last) in PEOPLE.items():
        for step in range(first, last):
            place = {"x": round(0.4 * step, 4), "y": float(person)}
            rows.append({"track": {"f": 1000 + 20 * step, "p": person, **place}})
    path.write_text("".join(f"{json.dumps(row)}\n" for row in rows))
    return path


@pytest.fixture(scope="module")
def forecast(official):
    """Its forecasts; what happened lies beside them."""
    return saved(official, None, official.with_name("out.ndjson"))[0]


def rows_of(path, kind="track"):
    rows = (json.loads(line) for line in path.read_text().splitlines())
    return [row[kind] for row in rows if kind in row]


def saved(path, recordings, out, samples=3, kind="constant_velocity_sampled"):
    from neurosym_jax.data.recordings import read_any
    from neurosym_jax.data.tables import ReadOptions

    tracks = read_any(path, ReadOptions(allow=tuple(GUARDS))) if path else recordings
    entries = [(None, baseline(kind, 8, 12))]
    return save_forecasts(
        out, [make_test(Case("hall", 8, 12), entries, tracks)], samples, 0
    )


def test_official_scenes_are_forecast_as_given(official, forecast):
    truth = forecast.with_name("out_truth.ndjson")
    assert (
        rows_of(truth, "scene")
        == rows_of(official, "scene")
        == rows_of(forecast, "scene")
    )
    assert read_scenes(truth) == read_scenes(official)
    assert read_scenes(official)[0].tag == [3, [1, 3]]
    places = {(row["f"], row["p"]): row for row in rows_of(official)}
    assert {(row["f"], row["p"]): row for row in rows_of(truth)} == places
    # Whoever was seen at any observed step is forecast, in every sample, at the scene's
    # frames.
    for scene, people, first in ((40, {5, 7, 9, 12}, 1180), (41, {5, 7, 9}, 1280)):
        rows = [row for row in rows_of(forecast) if row["scene_id"] == scene]
        assert {row["p"] for row in rows} == people
        assert len(rows) == 3 * len(people) * 12
        assert {row["f"] for row in rows} == {first + 20 * step for step in range(12)}
        assert {row["prediction_number"] for row in rows} == {0, 1, 2}


def test_a_file_with_a_single_scene_is_official(official, tmp_path):
    path = tmp_path / "one.ndjson"
    path.write_text(official.read_text().split("\n", 1)[1])
    forecast, _ = saved(path, None, tmp_path / "out.ndjson")
    assert [scene.id for scene in read_scenes(forecast)] == [41]


def test_forecasts_of_official_scenes_are_scored(official, tmp_path):
    """Scene 41's start is shared by nothing else; 12 and 9 are not seen at all observed steps."""
    forecast, _ = saved(official, None, tmp_path / "out.ndjson", 1, "constant_velocity")
    samples, ids, frames = read_predictions(forecast)
    assert samples.shape == (1, 7, 12, 2)
    ends = dict(zip(zip(frames.tolist(), ids.tolist()), samples[0, :, -1]))
    # Steps at which a person was not seen are walked on: 12 was last seen at step 3.
    assert ends[1160, 12] == pytest.approx((0.4 * 20, 12))
    assert ends[1160, 9] == pytest.approx((0.4 * 20, 9))
    options = {
        "forecasts": forecast,
        "baselines": ["constant_velocity"],
        "allow": tuple(GUARDS),
    }
    with pytest.raises(
        InputError, match="people in windows have no forecast, and 2 of 7 forecasts"
    ):
        nj.evaluate((), official, **options)
    rows = nj.evaluate((), official, **options, partial=True)
    assert rows["scenes"].to_list() == [2, 2]
    assert rows["joint_ade"].to_list() == pytest.approx([0, 0], abs=1e-4)


def test_windows_of_other_recordings_keep_frames_and_people(tmp_path):
    lines = [
        f"{780 + 10 * step} {person} {0.4 * step:.3f} {person}"
        for step, person in itertools.product(range(22), (4, 8))
    ]
    walk = tmp_path / "walk.txt"
    walk.write_text("\n".join(lines))
    forecast, truth = saved(walk, None, tmp_path / "out.ndjson")
    scenes = read_scenes(forecast)
    assert [(scene.start, scene.end, scene.person, scene.fps) for scene in scenes] == [
        (780 + 10 * at, 970 + 10 * at, 4, 2.5) for at in range(3)
    ]
    assert {row["p"] for row in rows_of(truth)} == {4, 8}
    assert {row["f"] for row in rows_of(truth)} == {
        780 + 10 * step for step in range(22)
    }
    rows = nj.evaluate((), walk, forecasts=forecast, baselines=["constant_velocity"])
    assert rows["agents"].to_list() == [6, 6]
    # One step does not say how far frames are apart: the frame before counts.
    ahead = [row for row in rows_of(forecast) if row["f"] == 860]
    short = tmp_path / "short.ndjson"
    short.write_text("".join(json.dumps({"track": row}) + "\n" for row in ahead))
    assert set(read_predictions(short)[2].tolist()) == {859}
    # Of two recordings, frames and people are numbered one after the other.
    stamp, person = (part.ravel() for part in np.mgrid[0:20, 0:2])
    recordings = [
        make_tracks(name, 0.4 * stamp, person, np.stack([0.4 * stamp, person], axis=1))
        for name in ("one", "two")
    ]
    forecast, truth = saved(None, recordings, tmp_path / "two.ndjson")
    assert [(scene.start, scene.person) for scene in read_scenes(forecast)] == [
        (0, 0),
        (20, 2),
    ]
    assert {row["p"] for row in rows_of(truth)} == {0, 1, 2, 3}
    # They are those that the evaluation scores: with its noise.
    (scored,) = saved(None, recordings, tmp_path / "two.npz")
    np.testing.assert_allclose(
        read_predictions(forecast)[0], np.load(scored)["samples"], atol=1e-3
    )


def test_sample_0_is_the_most_probable_and_the_others_follow(tmp_path):
    """The evaluator takes it for the best guess."""
    stamp, person = (part.ravel() for part in np.mgrid[0:20, 0:2])
    # One walks and one stands, so that their likely paths are not the first.
    xy = np.stack([0.5 * stamp * person, person], axis=1)
    recordings = [make_tracks("one", 0.4 * stamp, person, xy)]
    entries = [("mine", nj.load_model("recommended"))]
    test = make_test(Case("one", 8, 8), entries, recordings)
    path, _ = save_forecasts(tmp_path / "a.ndjson", [test], 20, 0)
    (arrays,) = save_forecasts(tmp_path / "a.npz", [test], 20, 0)
    written = read_predictions(path)[0]
    with np.load(arrays) as file:
        samples, likely = file["samples"], file["probabilities"]
    assert len(np.unique(likely[:, 0])) > 5
    order = np.argsort(-likely[:, 0], kind="stable")
    assert order.tolist() != sorted(order)
    np.testing.assert_allclose(written, samples[order], atol=1e-3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda rows: rows[1:], "scene 40, person 5: steps are missing"),
        (lambda rows: [*rows, rows[0]], "repeats sample 0 of person 5"),
        (lambda rows: [{**rows[0], "x": None}, *rows[1:]], "row 1: x is not a number"),
        (lambda rows: [], "the file has no"),
        (
            lambda rows: [row for row in rows if row["f"] < 1300],
            "forecasts of 3 x 1 and 3 x 6",
        ),
    ],
)
def test_files_that_are_no_forecasts_are_refused(forecast, tmp_path, change, message):
    rows = change(rows_of(forecast))
    path = tmp_path / "bad.ndjson"
    path.write_text("".join(f"{json.dumps({'track': row})}\n" for row in rows))
    with pytest.raises(InputError, match=message):
        read_predictions(path)
