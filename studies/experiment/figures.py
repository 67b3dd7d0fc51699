"""The figures of the robot experiment's report, a scenario at a time."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from neurosym_robot.online.predictor import Forecast
from neurosym_robot.online.replay import STRAIGHT
from neurosym_robot.tracking.following import Frame, tracks_of_frames
from studies.experiment.results import Recording, complete, published

__all__ = ["write_figures"]


def write_figures(out: Path, recordings: Sequence[Recording]) -> list[str]:
    """Write the figures of one scenario's recordings to `out / "figures"`; Markdown of each."""
    from neurosym_jax.plotting import plot_forecasts, plot_horizon_errors
    from neurosym_jax.plotting.style import save_figure
    from neurosym_jax.plotting.tracks import plot_tracks

    first = recordings[0]
    names = [name for name in first.summary["models"] if name != STRAIGHT]
    blocks: list[str] = []

    def add(kind: str, figure, caption: str) -> None:
        path = out / "figures" / f"experiment_{first.scenario}_{kind}.png"
        save_figure(figure, path)
        blocks.append(f"![{caption}](figures/{path.name})")

    mended = [
        Frame(frame.stamp, ids[ids >= 0], frame.xy[ids >= 0])
        for frame, ids in zip(first.frames, first.mended, strict=True)
    ]
    tracks = [
        tracks_of_frames(iter(first.frames), "as the tracker named them"),
        tracks_of_frames(iter(mended), "stitched"),
    ]
    caption = "Recording 1 as the tracker named people, and stitched, a colour for each id"
    add("tracks", plot_tracks(tracks), caption)
    forecast = _median(first, names[-1])
    assert forecast.future is not None
    seconds = forecast.stamp - first.frames[0].stamp
    figure = plot_forecasts(
        forecast.observed,
        forecast.future,
        {name: published(forecast, name) for name in names},
        f"{seconds:.1f} s into recording 1",
    )
    add("median", figure, "The forecast with the median error")
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
        "Mean error at each step",
    )
    return blocks


def _median(recording: Recording, model: str) -> Forecast:
    """The forecast with the median error: chosen by rule and not by looks."""
    kept = complete(recording.forecasts)
    futures = np.array([forecast.future for forecast in kept])
    distance = np.linalg.norm(
        np.stack([published(forecast, model) for forecast in kept]) - futures, axis=-1
    )
    order = np.argsort(distance.mean(axis=(1, 2)), kind="stable")
    return kept[int(order[len(order) // 2])]
