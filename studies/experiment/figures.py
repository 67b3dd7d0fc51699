"""The figures of the robot experiment's report, a scenario at a time."""

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from neurosym_robot.online.analytics import STRAIGHT
from neurosym_robot.online.frames import Frame, tracks_of_frames
from neurosym_robot.online.predictor import Forecast
from studies.experiment.results import Recording, complete, published

__all__ = ["write_figures"]

DOTS, COLOURS = 150, 96
"""Dots per inch and colours of a PNG, so that each has a few tens of kilobytes."""


def write_figures(out: Path, recordings: Sequence[Recording]) -> list[str]:
    """Write the figures of one scenario's recordings to `out / "figures"`; Markdown of each."""
    from PIL import Image  # comes with matplotlib

    from neurosym_jax.plotting import plot_fan, plot_forecasts, plot_horizon_errors
    from neurosym_jax.plotting.tracks import plot_tracks

    first = recordings[0]
    names = [name for name in first.summary["models"] if name != STRAIGHT]
    blocks: list[str] = []

    def add(kind: str, figure, caption: str) -> None:
        path = out / "figures" / f"experiment_{first.scenario}_{kind}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        buffer = io.BytesIO()
        figure.savefig(buffer, dpi=DOTS)
        Image.open(buffer).convert("RGB").quantize(COLOURS).save(path, optimize=True)
        blocks.extend([f"![{caption}](figures/{path.name})", caption])

    mended = [
        Frame(frame.stamp, ids[ids >= 0], frame.xy[ids >= 0])
        for frame, ids in zip(first.frames, first.mended, strict=True)
    ]
    tracks = [
        tracks_of_frames(iter(first.frames), "as the tracker named them"),
        tracks_of_frames(iter(mended), "stitched"),
    ]
    add("tracks", plot_tracks(tracks), "Recording 1: a colour an id, a dot where each begins.")
    for kind, forecast, caption in _moments(first, names[-1]):
        assert forecast.future is not None
        seconds = forecast.stamp - first.frames[0].stamp
        figure = plot_forecasts(
            forecast.observed,
            forecast.future,
            {name: published(forecast, name) for name in names},
            f"{seconds:.1f} s into recording 1",
        )
        add(kind, figure, caption)
        if kind == "median":
            samples = forecast.models[names[-1]].samples
            figure = plot_fan(forecast.observed, forecast.future, samples, names[-1])
            add("fan", figure, f"The same moment with all samples of {names[-1]}.")
    errors = {
        name: np.average(
            [recording.scores[name].horizon for recording in recordings],
            axis=0,
            weights=[recording.scores[name].sequences for recording in recordings],
        )
        for name in first.scores
    }
    add(
        "horizon",
        plot_horizon_errors(errors, 0.4, "error over the horizon"),
        "Mean error of the published forecast at each step, both recordings.",
    )
    return blocks


def _moments(recording: Recording, model: str) -> list[tuple[str, Forecast, str]]:
    """Forecasts to show, chosen by rule and not by looks."""
    kept = complete(recording.forecasts)
    futures = np.array([forecast.future for forecast in kept])
    distance = np.linalg.norm(
        np.stack([published(forecast, model) for forecast in kept]) - futures, axis=-1
    )
    order = np.argsort(distance.mean(axis=(1, 2)), kind="stable")
    near = np.linalg.norm(futures[:, 0] - futures[:, 1], axis=-1).min(axis=1)
    return [
        (
            "median",
            kept[int(order[len(order) // 2])],
            f"The forecast of recording 1 in which {model}'s error is the median.",
        ),
        (
            "closest",
            kept[int(near.argmin())],
            "The forecast of recording 1 in which the two people come closest to each other.",
        ),
    ]
