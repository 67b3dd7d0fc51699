"""TrajNet++'s own evaluator on files that we write for its official scenes: the same errors."""

import itertools
import json
import types

import numpy as np
import pytest

from neurosym_jax.data.readers.trajnet import read_scenes
from neurosym_jax.data.recordings import read_any
from neurosym_jax.data.tables import GUARDS, ReadOptions
from neurosym_jax.evaluation.compare import TestSet as Case
from neurosym_jax.evaluation.compare import baseline, make_test
from neurosym_jax.evaluation.saved_forecasts import save_forecasts
from neurosym_jax.evaluation.scores import score

LENGTHS = types.SimpleNamespace(obs_length=9, pred_length=12, disable_collision=False)
SCENES = 100


def first_scenes(source, target):
    """The first official scenes of a recording, and the points up to their end."""
    rows = [json.loads(line) for line in source.read_text().splitlines()]
    scenes = [row for row in rows if "scene" in row][:SCENES]
    end = max(row["scene"]["e"] for row in scenes)
    points = [row for row in rows if "track" in row and row["track"]["f"] <= end]
    target.write_text("".join(f"{json.dumps(row)}\n" for row in [*scenes, *points]))


def own_errors(forecast, truth):
    """Means over scenes of ADE and FDE of sample 0 and of the best of three, by our metrics."""
    places, samples = {}, {}
    for path in (truth, forecast):
        for line in path.read_text().splitlines():
            row = json.loads(line).get("track")
            if row:
                xy = (row["x"], row["y"])
                if "prediction_number" in row:
                    key = row["scene_id"], row["p"], row["prediction_number"]
                    samples.setdefault(key, {})[row["f"]] = xy
                else:
                    places[row["f"], row["p"]] = xy
    names, errors = ("marginal_ade", "marginal_fde"), []
    for scene in read_scenes(truth):
        paths = [samples[scene.id, scene.person, number] for number in range(3)]
        future = np.array([[places[frame, scene.person] for frame in sorted(paths[0])]])
        ways = []
        for path in paths:
            ways.append([[path[frame] for frame in sorted(path)]])
        x = np.array(ways)
        best = np.linalg.norm(x - future, axis=-1).mean(axis=(1, 2)).argmin()
        chosen = (x[:1], x[best : best + 1])
        scored = [score(sample, future, metrics=names) for sample in chosen]
        errors.append(
            [scores[name].total[0] for scores, name in itertools.product(scored, names)]
        )
    return np.mean(errors, axis=0)


@pytest.mark.parametrize("kind", ["constant_velocity_sampled", "anchor_table"])
def test_its_evaluator_agrees_to_six_digits(peer, tmp_path, capsys, kind):
    folder = peer("trajnetplusplustools", "trajnetplusplusbaselines")
    evaluator = pytest.importorskip("evaluator.trajnet_evaluator")
    source = (
        folder
        / "trajnetplusplusbaselines/DATA_BLOCK/trajdata/train/crowds_zara01.ndjson"
    )
    path = tmp_path / "zara.ndjson"
    first_scenes(source, path)
    tracks = read_any(path, ReadOptions(allow=tuple(GUARDS)))
    test = make_test(Case("zara", 8, 12), [(None, baseline(kind, 8, 12))], tracks)
    forecast, truth = save_forecasts(tmp_path / "out.ndjson", [test], 20, 0)
    assert read_scenes(forecast) == read_scenes(path)
    metrics, *_ = evaluator.eval(str(path), str(forecast), LENGTHS)
    assert metrics.N == SCENES
    peer_metrics = [
        metrics.average_l2,
        metrics.final_l2,
        metrics.topk_ade,
        metrics.topk_fde,
    ]
    np.testing.assert_allclose(
        own_errors(forecast, truth), np.array(peer_metrics) / SCENES, atol=5e-7
    )
    # Every neighbour that it counts is forecast, so that it counts collisions (Col-I).
    assert "does not predict all neighbours" not in capsys.readouterr().out
    assert 0 <= metrics.pred_col <= SCENES
    # What happened is a file that it takes for the truth, too.
    again, *_ = evaluator.eval(str(truth), str(forecast), LENGTHS)
    assert vars_of(again) == pytest.approx(vars_of(metrics), abs=1e-3)
    print(
        kind,
        *(f"{value / SCENES:.6f}" for value in peer_metrics),
        own_errors(forecast, truth),
    )


def vars_of(metrics):
    names = ("average_l2", "final_l2", "topk_ade", "topk_fde", "pred_col", "gt_col")
    return [getattr(metrics, name) for name in names]
