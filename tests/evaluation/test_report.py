"""Files of an evaluation: reports are replaced whole; forecasts are those that were scored."""

import dataclasses
import json
import sys

import numpy as np
import polars as pl
import pytest

import neurosym_jax as nj
from neurosym_jax.data.tracks import make_tracks
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.compare import TestSet as Case
from neurosym_jax.evaluation.compare import (
    baseline,
    check_report,
    make_test,
    read_report,
    write_report,
)
from neurosym_jax.evaluation.saved_forecasts import (
    check_forecasts_file,
    forecasts_of,
    save_forecasts,
    to_xarray,
)
from neurosym_jax.evaluation.scores import score, score_forecaster
from neurosym_jax.models.anchors.network import AnchorConfig
from tests.networks import random_model

ORIGIN = np.array([5e5, 4e6])


def walk(name, people, far=0.0):
    stamp, person = (
        part.ravel() for part in np.meshgrid(np.arange(14.0), np.arange(people))
    )
    xy = np.stack([0.4 * stamp, person + 0.02 * stamp**2], 1) + far
    return make_tracks(name, stamp * 0.4, person.astype(int), xy)


@pytest.fixture(scope="module")
def test_set():
    names = ("constant_velocity", "constant_velocity_sampled")
    entries = [(None, baseline(name, 4, 6)) for name in names]
    return make_test(Case("walk", 4, 6), entries, [walk("a", 2, ORIGIN), walk("b", 5)])


def test_saved_forecasts_are_those_that_were_scored(test_set, tmp_path):
    model = test_set.entries[1][1]
    arrays = forecasts_of(model, test_set, 3, 7)
    assert arrays["samples"].shape == (3, test_set.windows.agents, 6, 2)
    evaluated = score_forecaster(
        model.forecaster, {}, test_set.batches, samples=3, seed=7
    )
    for scene in range(test_set.windows.scenes):
        rows = arrays["scene"] == scene
        own = score(arrays["samples"][:, rows], arrays["truth"][rows])["joint_ade"]
        assert own.total[0] == pytest.approx(
            evaluated.scores["joint_ade"].total[scene], abs=1e-4
        )
    assert set(arrays["recordings"]) == {"a", "b"}
    assert (
        np.abs(arrays["samples"][:, arrays["recordings"] == "a"] - ORIGIN).max() < 100
    )
    paths = save_forecasts(tmp_path / "out.npz", [test_set], 3, 7)
    assert [path.name for path in paths] == [
        "out_walk_4_6_constant_velocity.npz",
        "out_walk_4_6_constant_velocity_sampled.npz",
    ]
    saved = np.load(paths[1])
    assert set(saved) == set(arrays)
    np.testing.assert_allclose(saved["samples"], arrays["samples"], atol=1e-4)


def test_forecasts_that_memory_cannot_hold_are_refused(test_set):
    """Three copies of two float64 of each position."""
    samples = 10**9
    needed = 24 * 2 * samples * test_set.windows.agents * 6
    refusal = f"saving forecasts needs some {needed / 1e9:.1f} .* ask for fewer samples"
    with pytest.raises(InputError, match=refusal):
        forecasts_of(test_set.entries[1][1], test_set, samples, 0)


def test_xarray_labels_what_is_saved(test_set, tmp_path, monkeypatch):
    xarray = pytest.importorskip("xarray")
    arrays = forecasts_of(test_set.entries[1][1], test_set, 3, 0)
    path = save_forecasts(tmp_path / "out.nc", [test_set], 3, 0)[1]
    with xarray.open_dataset(path, engine="scipy") as stored:
        people = stored.isel(agent=np.flatnonzero(arrays["scene"] == 4)).sel(
            time=0.8, xy="y"
        )
        moved = arrays["samples"][:, arrays["scene"] == 4, 1, 1]
        np.testing.assert_allclose(people.samples, moved, atol=1e-4)
        assert people.samples.dims == ("sample", "agent")
        assert stored.ids.values.tolist() == arrays["ids"].tolist()
        np.testing.assert_allclose(stored.past, [-1.2, -0.8, -0.4, 0])
        np.testing.assert_allclose(stored.observed, arrays["observed"], atol=1e-4)
        assert set(stored.recordings.values.astype(str)) == {"a", "b"}
    own = to_xarray(arrays["samples"], probabilities=[0.5, 0.3, 0.2], period=0.5)
    assert float(
        own.weighted(own.probabilities).mean("sample").samples[0, 0, 0]
    ) == pytest.approx(
        np.average(arrays["samples"][:, 0, 0, 0], weights=[0.5, 0.3, 0.2])
    )
    assert own.time.values[0] == 0.5
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(InputError, match="needs xarray: pip install"):
        check_forecasts_file(tmp_path / "other.nc")


def test_trajnet_has_the_most_probable_forecast_first(tmp_path):
    model = random_model(AnchorConfig(obs_len=4, pred_len=6, samples=4, hidden=8))
    test = make_test(Case("walk", 4, 6), [("m", model)], [walk("a", 3)])
    arrays = forecasts_of(model, test, 4, 0)
    best = arrays["probabilities"].argmax(axis=0)
    assert best.all()  # Not the first.
    path = save_forecasts(tmp_path / "out.ndjson", [test], 4, 0)[0]
    tracks = (
        json.loads(line).get("track", {}) for line in path.read_text().splitlines()
    )
    first = [
        [track["x"], track["y"]]
        for track in tracks
        if track.get("prediction_number") == 0
    ]
    expected = arrays["samples"][best, np.arange(len(best))]
    np.testing.assert_allclose(np.reshape(first, expected.shape), expected, atol=1e-4)
    elsewhere = walk("a", 3)
    elsewhere = dataclasses.replace(elsewhere, stamp=elsewhere.stamp + 1e9)
    with pytest.raises(
        InputError, match=r"saved with the recording .*out_truth\.ndjson"
    ):
        nj.evaluate(recordings=elsewhere, forecasts=path, obs_len=4)
    truth = path.with_stem("out_truth")
    rows = nj.evaluate(
        recordings=truth, forecasts=path, obs_len=4, metrics="central_ade"
    )
    assert rows["central_ade"][-1] > 0


def test_a_report_is_replaced_and_it_is_said(tmp_path, capsys):
    path = tmp_path / "new/rows.json"
    assert not check_report(path)
    write_report(path, [], {})
    assert capsys.readouterr() == ("", "")
    write_report(
        path, [{"model": "a"}, {"model": "b", "crps": 1.0}], {"protocol": "sgan"}
    )
    assert capsys.readouterr().err == f"replacing the report in {path}\n"
    assert json.loads(path.read_text()) == {
        "format": 2,
        "protocol": "sgan",
        "rows": [{"model": "a"}, {"model": "b", "crps": 1.0}],
    }
    expected = pl.DataFrame({"model": ["a", "b"], "crps": [None, 1.0]})
    assert read_report(path).equals(expected)
    path.write_text('{"format": 1, "rows": []}')
    with pytest.raises(InputError, match="is not a report of ours of format 2"):
        read_report(path)


@pytest.mark.parametrize(
    "content", [b"thesis", b"[]", b'{"format": 1}', b"\xff\x00", b"", b"[" * 9**5]
)
def test_nothing_else_is_overwritten(tmp_path, content):
    log = tmp_path / "rows.jsonl"
    log.write_bytes(content)
    if content:
        with pytest.raises(InputError, match=r"rows.jsonl: is not a report of ours"):
            check_report(tmp_path / "rows.json")
    path = tmp_path / "mine.json"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"mine.json: is not a report of ours"):
        write_report(path, [], {})
    with pytest.raises(
        InputError, match=r"mine.json: is not a report of ours of format 2"
    ):
        read_report(path)
    assert path.read_bytes() == content
    for place in (tmp_path, path / "rows.json"):
        with pytest.raises(InputError, match="cannot be written"):
            write_report(place, [], {})
