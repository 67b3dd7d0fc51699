"""The figures of the robot experiment's report, a scenario at a time."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from neurosym_robot.online.predictor import Forecast
from neurosym_robot.online.replay import STRAIGHT
from studies.experiment.results import PEOPLE, Recording, complete, published

__all__ = ["write_figures"]


def write_figures(out: Path, recordings: Sequence[Recording]) -> list[str]:
    """Write the figures of one scenario's recordings to `out / "figures"`; Markdown of each."""
    from neurosym_jax.plotting import plot_forecasts, plot_horizon_errors
    from neurosym_jax.plotting.style import save_figure

    first = recordings[0]
    names = [name for name in first.summary["models"] if name != STRAIGHT]
    blocks: list[str] = []

    def add(kind: str, figure, caption: str) -> None:
        path = out / "figures" / f"experiment_{first.scenario}_{kind}.png"
        save_figure(figure, path)
        blocks.append(f"![{caption}](figures/{path.name})")

    caption = "When each id of recording 1 was seen, a row for each id, a colour for each person"
    add("tracks", _plot_ids(first), caption)
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
    errors = {}
    for name in first.scores:
        scores = [recording.scores[name] for recording in recordings]
        weights = [score.sequences for score in scores]
        horizons = [score.horizon for score in scores]
        errors[name] = np.average(horizons, axis=0, weights=weights)
    add(
        "horizon",
        plot_horizon_errors(errors, 0.4, "error over the horizon"),
        "Mean error at each step",
    )
    return blocks


def _plot_ids(recording: Recording) -> Figure:
    """When each id was seen, one row for each in the order of their first frames; the colour is
    that of the person whom it names."""
    from neurosym_jax.plotting import style

    figure, (panels,) = style.new_figure(style.WIDTH, 2.2, 1, 2, sharey=True)
    tracked = [frame.ids for frame in recording.frames]
    began, people = recording.frames[0].stamp, np.concatenate(recording.people)
    seconds = np.concatenate(
        [np.full(len(frame.ids), frame.stamp) for frame in recording.frames]
    )
    for axes, ids, title in zip(
        panels, (tracked, recording.mended), ("the tracker's", "stitched")
    ):
        ids = np.concatenate(ids)
        names, first = np.unique(ids[ids >= 0], return_index=True)
        rows = {name: row for row, name in enumerate(names[np.argsort(first)], 1)}
        for person, colour in enumerate(style.PALETTE[:PEOPLE]):
            seen = (ids >= 0) & (people == person)
            height = [rows[name] for name in ids[seen]]
            axes.plot(seconds[seen] - began, height, "|", color=colour, ms=5)
        style.dress(axes, "time [s]", title=f"{len(rows)} ids, {title}")
    panels[0].invert_yaxis()
    panels[0].set_ylabel("id, by its first frame")
    return figure


def _median(recording: Recording, model: str) -> Forecast:
    """The forecast with the median error: chosen by rule and not by looks."""
    forecasts = complete(recording.forecasts)
    futures = np.array([forecast.future for forecast in forecasts])
    distance = np.linalg.norm(
        np.stack([published(forecast, model) for forecast in forecasts]) - futures,
        axis=-1,
    )
    order = np.argsort(distance.mean(axis=(1, 2)), kind="stable")
    return forecasts[int(order[len(order) // 2])]
