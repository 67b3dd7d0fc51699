"""Show a recording's QTC symbols and weights.

States of a scene's pairs over time as text, and alpha as a heat map over pairs and
time. With --forecast, the probabilities of the pairs' events and states in the model's
samples, as text and JSON lines.
"""

import json
from pathlib import Path
from typing import Any, Literal

import numpy as np

from neurosym_jax.commands._options import Positional, Reading, open_data, refuse_given
from neurosym_jax.configuration import Count, Seed, component, refuse
from neurosym_jax.data.tables import AS_IT_SAYS
from neurosym_jax.data.windows import Windows, cut_windows
from neurosym_jax.errors import InputError
from neurosym_jax.models.disk import find_model, load_model, spoken_name
from neurosym_jax.models.distribution import predict_distribution
from neurosym_jax.models.forecast import Model
from neurosym_jax.models.forecaster import Lengths
from neurosym_jax.runtime.files import write_text
from neurosym_jax.scene import make_scene
from neurosym_jax.symbolic.forecast import (
    SymbolSettings,
    forecast_rows,
    format_forecast,
    format_pairs,
)
from neurosym_jax.symbolic.weighting import WEIGHTINGS, initial_parameters, is_constant

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
        data: Recording, a folder of them, or ETH/UCY; default: the embedded
            simulations.
        dataset: Data set (eth, hotel, ..., or a file's name); default: the first.
        window: Index of the window to show; default: the first with the most people, up
            to five.
        weighting: Weighting, as in `neurosym train`; default: the model's, else cnd.
        model: Model whose weights or, with --forecast, forecast are shown; without,
            windows are 8 + 8.
        forecast: Show instead the model's forecast of the pairs: events and states with
            probabilities.
        samples: Number of forecasts of the scene, k.
        seed: Random seed of the noise.
        out: Folder of the figures.
        style: Look of the figure; a talk's has larger letters and lines.
        read: How files are read.

    Raises:
        InputError: for data, a window, a weighting or a model that cannot be used.
    """
    if forecast:
        refuse_given("with --forecast", weighting=weighting, style=style != "paper")
    else:
        refuse_given("without --forecast", samples=samples != SAMPLES, seed=seed)
    refuse(Count, {"--samples": samples})
    refuse(Seed, {"--seed": seed})
    network, called = None, ""
    if model:
        place = find_model(model, dataset)
        network = load_model(place)
        called = spoken_name(model, place, network)
    lengths = network.config if network else Lengths()
    source = open_data(data, read, dataset, period=lengths.period)
    name = dataset or source.scenes[0]
    windows = cut_windows(source.recordings(name), lengths.obs_len, lengths.pred_len)
    window, example = _example(windows, window)
    title = f"{name}, window {window}"
    if not forecast:
        if weighting is None and network and network.config.weighting is None:
            raise InputError(
                f"{model}: {network.name} weighs no pairs: name a --weighting"
            )
        _show_weights(network, weighting, style, title, example, out / "pairs.png")
    elif network:
        title += f": {len(example.agent)} people, {samples} samples of {called}"
        _show_forecast(network, samples, seed, title, example, out / "forecast.jsonl")
    else:
        raise InputError("--forecast needs a --model that forecasts")


def _example(windows: Windows, window: int | None) -> tuple[int, Windows]:
    """The number of the window to show, and the window alone."""
    if window is None:
        most = max(CROWD, windows.sizes.min())
        window = int(np.where(windows.sizes <= most, windows.sizes, 0).argmax())
    if not 0 <= window < windows.scenes:
        raise InputError(f"--window must lie in [0, {windows.scenes}), not {window}")
    return window, windows.take(slice(window, window + 1))


def _show_forecast(
    model: Model, samples: int, seed: int, title: str, example: Windows, path: Path
) -> None:
    """Print and write the events and states of a window's pairs that the model forecasts."""
    observed = example.position[:, : example.obs_len]
    futures = predict_distribution(model, observed, draws=samples, seed=seed)
    rows = forecast_rows(
        futures, observed, example.agent, SymbolSettings(example.period)
    )
    write_text(path, "".join(json.dumps(row, allow_nan=False) + "\n" for row in rows))
    print(f"{title}\n\n{format_forecast(rows)}\n\n{path}")


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

    if model and text is None:
        weighting = model.config.weighting
        parameters = model.params.get("weighting", {})
    else:
        text = text or "cnd"
        weighting = component(text, WEIGHTINGS, f"--weighting {text}")
        parameters = initial_parameters(weighting)
    observed = make_scene(example.position).observed
    codes, alpha = (
        np.asarray(values(parameters, observed, period=example.period))
        for values in (weighting.codes, weighting.alpha)
    )
    hint = " is constant here; try --weighting quantised" if is_constant(alpha) else ""
    print(f"{title}: {len(example.agent)} people, weighting {weighting.name}{hint}\n")
    print(format_pairs(codes, example.agent, example.period))
    use_style(style)
    figure = plot_pairs(example, codes, alpha, f"{title}, {weighting.name}{hint}")
    print(f"\n{save_figure(figure, path)}")
