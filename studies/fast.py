"""Bicycles and others who are fast: energy scores of `recommended` and constant velocity.

python -m studies.fast OPENTRAJ

OPENTRAJ is the public repository crowdbotp/OpenTraj, whose `datasets/SDD` has Stanford's
drone scenes with labels (`annotations.txt`, pixels, 30 frames a second) and their scales
(`H_SDD.txt`). Cars, carts and buses are left out. Windows are of 8 + 8 or 8 + 12 steps
of 0.4 s, begun every 1.2 s. The score is a person's own, by 100 draws and the unbiased
estimator, of people whose observed speed lies in a range.
"""

import csv
import sys
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.data.tracks import PERIOD, Tracks, make_tracks
from neurosym_jax.data.windows import Windows, cut_windows, make_batches
from neurosym_jax.models.baselines import ConstantVelocitySampled
from neurosym_jax.models.disk import load_model
from neurosym_jax.models.forecast import Model, batch_noise, draw_batch, forecast_batch

FRAMES = 12
"""Frames of Stanford's videos in a step."""
WHEELED = ("Biker", "Skater")
WALKING = "Pedestrian"
SPEEDS = ((0.0, 3.0), (3.0, 4.0), (4.0, 6.0), (6.0, 20.0))
"""Ranges of mean observed speed, m/s."""
DRAWS = 100


def scales(path: Path) -> dict[str, float]:
    """Metres a pixel of each video, `gates_0` and so on, of the file H_SDD.txt."""
    lines = [line.split() for line in path.read_text().splitlines()[1:]]
    return {Path(line[0]).stem: float(line[-1]) for line in lines if line}


def read_video(path: Path, scale: float, name: str) -> Tracks:
    """People of one video at every 0.4 s, in metres; `wheels` is 1 on a bicycle or board."""
    rows = [line.split() for line in path.read_text().splitlines()]
    rows = [row for row in rows if row[9].strip('"') in (WALKING, *WHEELED)]
    numbers = np.array([[float(value) for value in row[:7]] for row in rows])
    wheels = np.array([row[9].strip('"') in WHEELED for row in rows], float)
    seen = (numbers[:, 5] % FRAMES == 0) & (numbers[:, 6] == 0)
    numbers, wheels = numbers[seen], wheels[seen]
    centre = (numbers[:, 1:3] + numbers[:, 3:5]) / 2
    stamp = numbers[:, 5] / FRAMES * PERIOD
    ids = numbers[:, 0].astype(int)
    return make_tracks(name, stamp, ids, scale * centre, {"wheels": wheels})


def read_videos(opentraj: Path) -> list[Tracks]:
    """All videos whose annotations are there."""
    folder = opentraj / "datasets/SDD"
    metres = scales(folder / "H_SDD.txt")
    videos = []
    for path in sorted(folder.glob("*/video*/annotations.txt")):
        name = f"{path.parts[-3]}_{path.parts[-2].removeprefix('video')}"
        if name in metres:
            videos.append(read_video(path, metres[name], name))
    return videos


def personal_energies(draws: np.ndarray, future: np.ndarray) -> np.ndarray:
    """[A] unbiased energy score of each person's `draws [n, A, T, 2]`, metres.

    `future` is [A, T, 2].
    """
    count, _, steps, _ = draws.shape
    offset = (draws - future).swapaxes(0, 1).reshape(len(future), count, -1)
    product = offset @ offset.swapaxes(1, 2)
    square = np.diagonal(product, axis1=1, axis2=2)
    gap = square[:, :, None] + square[:, None] - 2 * product
    spread = np.sqrt(np.maximum(gap, 0)).sum((1, 2)) / (count * (count - 1))
    return (np.sqrt(square).mean(1) - spread / 2) / np.sqrt(steps)


def energies(model: Model | None, windows: Windows) -> np.ndarray:
    """[A] of all agent windows; without a model, of constant velocity with sampled headings."""
    result = np.zeros(windows.agents)
    for batch in make_batches(windows):
        scene, valid = batch.scene, np.asarray(batch.scene.valid)
        if model is None:
            config: Any = load_model("recommended", pred_len=_ahead(windows)).config
            forecaster = ConstantVelocitySampled(config)
            noise = batch_noise(forecaster, scene, DRAWS, 0)
            draws, _ = forecast_batch(forecaster, {}, scene, noise)
        else:
            everybody = draw_batch(model.forecaster, model.params, scene, 0, DRAWS)
            draws = everybody[:, valid]
        scenes = batch.index[batch.index >= 0]
        future = np.asarray(scene.known_future)[valid]
        result[windows.rows(scenes)] = personal_energies(draws, future)
    return result


def _ahead(windows: Windows) -> int:
    return windows.position.shape[1] - windows.obs_len


def main(opentraj: Path) -> None:
    """Print a table: a line for each length and range of speeds."""
    videos = read_videos(opentraj)
    writer = csv.writer(sys.stdout, lineterminator="\n")
    head = ("who", "speed, m/s", "steps", "windows", "recommended", "constant velocity")
    writer.writerow((*head, "difference, 95 %"))
    for ahead in (8, 12):
        windows = cut_windows(videos, 8, ahead, skip=3)
        model = load_model("recommended", pred_len=ahead)
        ours, theirs = energies(model, windows), energies(None, windows)
        observed = windows.position[:, :8]
        way = np.linalg.norm(np.diff(observed, axis=1), axis=-1).sum(1)
        speed = way / (7 * PERIOD)
        recording = np.repeat(windows.identity[:, 0], windows.sizes)
        owner = recording.astype(np.int64) * 2**20 + windows.agent
        for who, wheeled in (("on foot", 0), ("on wheels", 1)):
            for low, high in SPEEDS:
                mine = (windows.extras["wheels"] == wheeled) & (speed >= low)
                mine &= speed < high
                if mine.sum() < 10:
                    continue
                people = np.unique(owner[mine], return_inverse=True)[1]
                difference = np.bincount(people, (ours - theirs)[mine])
                share = difference / mine.sum()
                half = 1.96 * np.sqrt(np.square(share - share.mean()).sum())
                means = (ours[mine].mean(), theirs[mine].mean(), share.sum())
                row = [who, f"{low:g} to {high:g}", f"8 + {ahead}", int(mine.sum())]
                row += [f"{mean:.3f}" for mean in means[:2]]
                writer.writerow([*row, f"{means[2]:+.3f} ± {half:.3f}"])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
