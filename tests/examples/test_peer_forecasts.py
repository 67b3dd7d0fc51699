"""Saved formats of peers, written by hand as their code writes them, are read row by row."""

import itertools
import runpy
from types import SimpleNamespace

import numpy as np
import pytest

import neurosym_jax as nj
from neurosym_jax.evaluation.forecasts import read_forecasts
from tests.repository import ROOT

peers = SimpleNamespace(**runpy.run_path(str(ROOT / "examples/peer_forecasts.py")))


@pytest.fixture
def walk(tmp_path):
    """Two people for 18 steps, frames 10 apart from 100; and straight on, by frame and person."""
    xy = {
        (100 + 10 * step, person): (0.4 * step, 2.0 * person)
        for step, person in itertools.product(range(18), (3, 4))
    }
    path = tmp_path / "walk.txt"
    path.write_text(
        "".join(f"{f}\t{p}\t{x:.2f}\t{y:.2f}\n" for (f, p), (x, y) in xy.items())
    )
    return path, xy


def scored(arrays, walk, tmp_path):
    np.savez(tmp_path / "theirs.npz", **arrays)
    assert read_forecasts(tmp_path / "theirs.npz").steps == 8
    rows = nj.evaluate((), walk[0], forecasts=tmp_path / "theirs.npz", baselines=[])
    return rows["joint_ade"].item(), rows["agents"].item()


FRAMES = (170, 180, 190)


def test_agentformer(walk, tmp_path):
    for frame in FRAMES:
        folder = tmp_path / f"samples/frame_{frame // 10:06d}"
        folder.mkdir(parents=True)
        for number, offset in enumerate((0.0, 3.0)):
            rows = []
            for person, step in itertools.product((3, 4), range(1, 9)):
                x, y = walk[1][frame + 10 * step, person]
                start = f"{frame / 10 + step:.1f} {person:.1f}"
                rows.append(f"{start} {x + offset:.4f} {y:.4f}")
            (folder / f"sample_{number:03d}.txt").write_text("\n".join(rows))
    arrays = peers.agentformer(tmp_path / "samples", stride=10)
    assert arrays["samples"].shape == (2, 6, 8, 2)
    assert scored(arrays, walk, tmp_path) == (pytest.approx(0, abs=1e-5), 6)


def futures(walk, frame, person, shift=0.0):
    return np.array(
        [[np.array(walk[1][frame + 10 * n, person]) + shift for n in range(1, 9)]]
    )


def test_trajectron(walk, tmp_path):
    predictions = {(frame - 100) // 10: {} for frame in FRAMES}
    for frame, person in itertools.product(FRAMES, (3, 4)):
        samples = futures(walk, frame, person, -5.0)[None]
        predictions[(frame - 100) // 10][f"PEDESTRIAN/{person}"] = samples
    arrays = peers.trajectron(predictions, (5.0, 5.0), first=100)
    assert scored(arrays, walk, tmp_path) == (pytest.approx(0, abs=1e-5), 6)


def test_loaders_like_sgans(walk, tmp_path):
    scenes = []
    for frame in FRAMES:
        people = [futures(walk, frame, person)[0] for person in (3, 4)]
        scenes.append(np.stack(people)[None])
    arrays = peers.in_loader_order(scenes, walk[0])
    assert arrays["frames"].tolist() == [170, 170, 180, 180, 190, 190]
    assert scored(arrays, walk, tmp_path) == (pytest.approx(0, abs=1e-5), 6)
    with pytest.raises(ValueError, match="2 scenes are not the loader's 3"):
        peers.in_loader_order(scenes[:2], walk[0])
