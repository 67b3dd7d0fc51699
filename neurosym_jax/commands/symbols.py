"""Show a recording's QTC symbols and weights.

States of a scene's pairs over time as text, and alpha as a heat map over pairs and
time. With --forecast, the probabilities of the pairs' events and states in the model's
samples, as text and JSON lines. With --out FILE.csv, the states of all pairs over time as
a table.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import jax
import numpy as np
import polars as pl
from jax import Array

from neurosym_jax.commands._options import Positional, Reading, open_data, refuse_given
from neurosym_jax.configuration import Count, Seed, component, refuse
from neurosym_jax.data.tables import AS_IT_SAYS
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.data.windows import Windows, cut_windows
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.tables import csv_text
from neurosym_jax.models.disk import find_model, load_model, spoken_name
from neurosym_jax.models.forecast import Model, predict_distribution
from neurosym_jax.models.forecaster import Lengths
from neurosym_jax.runtime.files import refuse_unwritable, write_text
from neurosym_jax.scene import make_scene
from neurosym_jax.symbolic.forecast import (
    SymbolSettings,
    forecast_rows,
    format_forecast,
    format_pairs,
)
from neurosym_jax.symbolic.table import pairs_over_time, states_of_pairs
from neurosym_jax.symbolic.weighting import (
    WEIGHTINGS,
    Parameters,
    Quantised,
    Weighting,
    initial_parameters,
    is_constant,
)

__all__ = ["run"]

SAMPLES, CROWD = 20, 5
"""Default number of forecasts, and number of people whose pairs a figure can show."""


def run(
    data: Positional[Path | None] = None,
    dataset: str | None = None,
    window: int | None = None,
    weighting: str | None = None,
    model: Path | None = None,
    forecast: bool = False,
    samples: int = SAMPLES,
    seed: int = 0,
    out: Path = Path("results/symbols"),
    style: Literal["paper", "talk"] = "paper",
    read: Reading = AS_IT_SAYS,
) -> None:
    """Show the QTC symbols and weights of a recording, and of one of its scenes.

    Args:
        data: Recording, folder of them, or ETH/UCY; default: embedded simulations.
        dataset: Data set (eth, hotel, ..., or a file's name); default: the first.
        window: Index of the window to show; default: the first with the most people.
        weighting: Weighting, as in `neurosym train`; default: the model's, else cnd.
        model: Model whose weights or forecast are shown; without, windows are 8 + 8.
        forecast: Show instead the model's forecast of the pairs: events and states with
            probabilities.
        samples: Number of forecasts of the scene, k.
        seed: Random seed of the noise.
        out: Folder of the figures, or FILE.csv: the states of all pairs over time.
        style: Look of the figure; a talk's has larger letters and lines.
        read: How files are read.

    Raises:
        InputError: for data, a window, a weighting or a model that cannot be used.
    """
    refuse(Count, {"--samples": samples})
    refuse(Seed, {"--seed": seed})
    is_table = out.suffix.lower() == ".csv"
    is_styled = style != "paper"
    if is_table:
        others = {"window": window is not None, "forecast": forecast}
        refuse_given(f"with --out {out}", style=is_styled, **others)
        refuse_unwritable(out)
    if forecast:
        refuse_given("with --forecast", weighting=weighting, style=is_styled)
    else:
        refuse_given("without --forecast", samples=samples != SAMPLES, seed=seed)
    network, called = _network(model, dataset)
    lengths = network.config if network else Lengths()
    source = open_data(data, read, dataset, period=lengths.period)
    name = dataset or source.scenes[0]
    recordings = source.recordings(name)
    if is_table:
        _write_states(network, weighting, recordings, lengths.period, out)
        return
    title, example = _example(name, recordings, lengths, window)
    if not forecast:
        _show_weights(network, weighting, style, title, example, out / "pairs.png")
    elif network:
        title += f": {len(example.agent)} people, {samples} samples of {called}"
        _show_forecast(network, samples, seed, title, example, out / "forecast.jsonl")
    else:
        raise InputError("--forecast needs a --model that forecasts")


def _network(model: Path | None, dataset: str | None) -> tuple[Model | None, str]:
    """The model at a path or of a name, and what it is called; None without one."""
    if model is None:
        return None, ""
    place = find_model(model, dataset)
    network = load_model(place)
    return network, spoken_name(model, place, network)


def _example(
    name: str, recordings: Sequence[Tracks], lengths: Any, window: int | None
) -> tuple[str, Windows]:
    """The title of the window to show, of a data set `name`, and the window alone."""
    windows = cut_windows(recordings, lengths.obs_len, lengths.pred_len)
    if window is None:
        most = max(CROWD, windows.sizes.min())
        shown = np.where(windows.sizes <= most, windows.sizes, 0)
        window = int(shown.argmax())
    if not 0 <= window < windows.scenes:
        raise InputError(f"--window must lie in [0, {windows.scenes}), not {window}")
    title = f"{name}, window {window}"
    return title, windows.take(slice(window, window + 1))


def _show_forecast(
    model: Model, samples: int, seed: int, title: str, example: Windows, path: Path
) -> None:
    """Print and write the events and states of a window's pairs that the model forecasts."""
    observed = example.position[:, : example.obs_len]
    futures = predict_distribution(model, observed, draws=samples, seed=seed)
    rows = forecast_rows(
        futures, observed, example.agent, SymbolSettings(example.period)
    )
    lines = [json.dumps(row, allow_nan=False) + "\n" for row in rows]
    write_text(path, "".join(lines))
    print(f"{title}\n\n{format_forecast(rows)}\n\n{path}")


def _weighting(model: Model | None, text: str | None) -> tuple[Weighting, Parameters]:
    """The weighting that `text` names, else the model's, else cnd; and its parameters.

    Raises:
        InputError: for a model that weighs no pairs.
    """
    if model is None or text is not None:
        text = text or "cnd"
        weighting = component(text, WEIGHTINGS, f"--weighting {text}")
        return weighting, initial_parameters(weighting)
    if model.config.weighting is None:
        raise InputError(f"{model.name} weighs no pairs: name a --weighting")
    return model.config.weighting, model.params.get("weighting", {})


def _write_states(
    model: Model | None,
    text: str | None,
    recordings: Sequence[Tracks],
    period: float,
    path: Path,
) -> None:
    """Write the states of all pairs of `recordings` at all steps, and say how many there are."""
    weighting, parameters = _weighting(model, text)
    thresholds = weighting.thresholds(parameters, period)
    parts = []
    for tracks in recordings:
        step = tracks.step
        if step is None:
            step = np.rint((tracks.stamp - tracks.stamp.min()) / period)
        first, second = pairs_over_time(step, tracks.id)
        states = states_of_pairs(tracks.position, first, second, thresholds)
        part = {
            "recording": np.full(len(first), tracks.recording),
            "seconds": tracks.stamp[first].round(6),
            "k": tracks.ids_as_given(first),
            "l": tracks.ids_as_given(second),
        }
        part |= {f"q{number + 1}": states[:, number] for number in range(4)}
        parts.append(pl.DataFrame(part))
    table = pl.concat(parts, how="vertical_relaxed")
    pairs = table.select("recording", "k", "l").n_unique()
    write_text(path, csv_text(table))
    print(f"{len(table)} states of {pairs} pairs, weighting {weighting.name}: {path}")


def _show_weights(
    model: Model | None,
    text: str | None,
    style: Any,
    title: str,
    example: Windows,
    path: Path,
) -> None:
    """Print the states of a window, and draw the weights that `text` or the model gives them."""
    from neurosym_jax.plotting import plot_pairs, save_figure, use_style

    weighting, parameters = _weighting(model, text)
    observed = make_scene(example.position).observed
    period = example.period

    # One program, and not one for each operation.
    @jax.jit
    def codes_and_alpha(parameters: Parameters) -> tuple[Array, Array]:
        codes = weighting.codes(parameters, observed, period=period)
        return codes, weighting.alpha(parameters, observed, period=period)

    codes, alpha = map(np.asarray, codes_and_alpha(parameters))
    hint = ""
    if is_constant(alpha):
        hint = " is constant here"
        if not isinstance(weighting, Quantised):
            hint += "; try --weighting quantised"
    print(f"{title}: {len(example.agent)} people, weighting {weighting.name}{hint}\n")
    print(format_pairs(codes, example.agent, example.period))
    use_style(style)
    figure = plot_pairs(example, codes, alpha, f"{title}, {weighting.name}{hint}")
    print(f"\n{save_figure(figure, path)}")
