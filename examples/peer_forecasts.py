"""Forecasts of AgentFormer, Trajectron++ and of loaders like SGAN's, as a file that we score.

np.savez("theirs.npz", **agentformer("results/.../samples/crowds_zara01", stride=10))
neurosym evaluate --data crowds_zara01.txt --pred-len 12 --forecasts theirs.npz --min-agents 1
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.data import cut_windows
from neurosym_jax.data.recordings import recordings_in
from neurosym_jax.evaluation.forecasts import last_frames, recording_names

Arrays = dict[str, np.ndarray]
"""`samples` [k, A, T, 2], `ids` [A] and `frames` [A], as docs/evaluate.md says."""


def agentformer(folder: Path | str, stride: int = 1) -> Arrays:
    """Read `frame_000123/sample_000.txt`, ... of one sequence: rows of frame, id, x and y.

    The folder's number is the last observed frame; `stride` frames of the recording are
    one there.
    """
    samples, ids, frames = [], [], []
    for moment in sorted(Path(folder).glob("frame_*")):
        rows = np.stack(
            [np.loadtxt(path, ndmin=2) for path in sorted(moment.glob("sample_*.txt"))]
        )
        for person in np.unique(rows[0, :, 1]):
            samples.append(rows[:, rows[0, :, 1] == person, 2:4])
            ids.append(int(person))
            frames.append(stride * int(moment.name.removeprefix("frame_")))
    return {
        "samples": np.stack(samples, 1),
        "ids": np.array(ids),
        "frames": np.array(frames),
    }


def trajectron(
    predictions: Mapping[int, Mapping[Any, np.ndarray]],
    origin: Sequence[float] = (0, 0),
    *,
    first: int = 0,
    stride: int = 10,
) -> Arrays:
    """Turn what `Trajectron.predict` returns, by timestep and node [1, k, T, 2], into arrays.

    `origin` is what its preprocessing subtracted from positions, `first` the
    recording's first frame, and `stride` frames are a timestep.
    """
    rows = [
        (
            first + stride * step,
            int(str(getattr(node, "id", node)).split("/")[-1]),
            forecast[0],
        )
        for step, nodes in predictions.items()
        for node, forecast in nodes.items()
    ]
    frames, ids, samples = zip(*rows)
    return {
        "samples": np.stack(samples, axis=1) + np.asarray(origin, float),
        "ids": np.array(ids),
        "frames": np.array(frames),
    }


def in_loader_order(
    scenes: Sequence[np.ndarray], recordings: Any, obs_len: int = 8
) -> Arrays:
    """Name forecasts [k, N, T, 2] of all scenes by SGAN's order, which ours is.

    For EigenTrajectory, Social-STGCNN and others whose loader is SGAN's; `recordings`
    in theirs.
    """
    samples = np.concatenate(scenes, axis=1)
    windows = cut_windows(recordings_in(recordings), obs_len, samples.shape[2])
    if [scene.shape[1] for scene in scenes] != windows.sizes.tolist():
        raise ValueError(f"{len(scenes)} scenes are not the loader's {windows.scenes}")
    names = {"frames": last_frames(windows), "recordings": recording_names(windows)}
    rows = {name: np.repeat(values, windows.sizes) for name, values in names.items()}
    return {"samples": samples, "ids": windows.agent, **rows}
