"""Show a recording's QTC symbols and weights.

States of a scene's pairs over time as text, and alpha as a heat map over pairs and time. With
--forecast, the probabilities of the pairs' events and states in the model's samples, as text and
JSON lines.
"""

import dataclasses
import json
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from neurosym_jax.commands._options import open_data, refuse_unused
from neurosym_jax.configuration import Count, Seed, component, refuse
from neurosym_jax.data.reading import AS_IT_SAYS, ReadOptions
from neurosym_jax.data.windows import Windows, cut_windows
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.forecaster import Lengths
from neurosym_jax.forecasting.model import Model, predict
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.runtime.files import write_text
from neurosym_jax.scene import make_scene
from neurosym_jax.symbolic.forecast import (
    SymbolSettings,
    forecast_rows,
    format_forecast,
    format_pairs,
)
from neurosym_jax.symbolic.weighting import initial_parameters, is_constant
from neurosym_jax.symbolic.weightings import WEIGHTINGS

__all__ = ["Options", "run"]

CROWD = 5
"""Number of people whose pairs a figure can show."""


@dataclasses.dataclass(frozen=True)
class Options:
    """Show the QTC symbols and weights of a recording, and of one of its scenes."""

    data: Annotated[Path | None, tyro.conf.Positional] = None
    """Recording, a folder of them, or ETH/UCY; default: the embedded simulations."""
    dataset: str | None = None
    """Data set (eth, hotel, ..., or a file's name); default: the first."""
    window: int | None = None
    """Index of the window to show; default: the first with the most people, up to five."""
    weighting: str | None = None
    """Weighting, as in `neurosym train`; default: the model's, else cnd."""
    model: Path | None = None
    """Model whose weights or, with --forecast, forecast are shown; without, windows are 8 + 8."""
    forecast: bool = False
    """Show instead the model's forecast of the pairs: events and states with probabilities."""
    samples: int = 20
    """Number of forecasts of the scene, k."""
    seed: int = 0
    """Random seed of the noise."""
    out: Path = Path("results/symbols")
    """Folder of the figures."""
    style: Literal["paper", "talk"] = "paper"
    """Look of the figure; a talk's has larger letters and lines."""
    read: Annotated[ReadOptions, tyro.conf.OmitArgPrefixes] = AS_IT_SAYS
    """How files are read."""


def run(options: Options) -> None:
    """Print and draw as `options` say.

    Raises:
        InputError: for data, a window, a weighting or a model that cannot be used.
    """
    if options.forecast:
        refuse_unused(options, ["weighting", "style"], "with --forecast")
    else:
        refuse_unused(options, ["samples", "seed"], "without --forecast")
    refuse(Count, {"--samples": options.samples})
    refuse(Seed, {"--seed": options.seed})
    model = options.model and load_model(options.model, dataset=options.dataset)
    source = open_data(options, options.dataset)
    name = options.dataset or source.scenes[0]
    lengths = model.config if model else Lengths()
    windows = cut_windows(source.recordings(name), lengths.obs_len, lengths.pred_len)
    number = options.window
    if number is None:
        sizes = np.where(windows.sizes <= max(CROWD, windows.sizes.min()), windows.sizes, 0)
        number = int(sizes.argmax())
    if not 0 <= number < windows.scenes:
        raise InputError(f"--window must lie in [0, {windows.scenes}), not {number}")
    shown = windows.take(slice(number, number + 1))
    title = f"{name}, window {number}"
    if not options.forecast:
        _show_weights(options, model, title, shown)
    elif model:
        _show_forecast(options, model, title, shown)
    else:
        raise InputError("--forecast needs a --model that forecasts")


def _show_weights(options: Options, model: Model | None, title: str, shown: Windows) -> None:
    if model and options.weighting is None:
        weighting, parameters = model.config.weighting, model.params.get("weighting", {})
        if weighting is None:
            raise InputError(f"{options.model}: {model.name} weighs no pairs: name a --weighting")
    else:
        text = options.weighting or "cnd"
        weighting = component(text, WEIGHTINGS, f"--weighting {text}")
        parameters = initial_parameters(weighting)
    observed = make_scene(shown.position).observed
    codes, alpha = (
        np.asarray(of(parameters, observed)) for of in (weighting.codes, weighting.alpha)
    )
    hint = " is constant here; try --weighting quantised" if is_constant(alpha) else ""
    print(f"{title}: {len(shown.agent)} people, weighting {weighting.name}{hint}\n")
    print(format_pairs(codes, shown.agent, shown.period))

    from neurosym_jax.plotting import plot_pairs, save_figure, use_style

    use_style(options.style)
    figure = plot_pairs(shown, codes, alpha, f"{title}, {weighting.name}{hint}")
    print(f"\n{save_figure(figure, options.out / 'pairs.png')}")


def _show_forecast(options: Options, model: Model, title: str, shown: Windows) -> None:
    observed = shown.position[:, : shown.obs_len]
    samples = predict(model, observed, samples=options.samples, seed=options.seed)
    rows = forecast_rows(samples, observed, shown.agent, SymbolSettings(shown.period))
    path = options.out / "forecast.jsonl"
    write_text(path, "".join(json.dumps(row, allow_nan=False) + "\n" for row in rows))
    print(f"{title}: {len(shown.agent)} people, {len(samples)} samples of {model.name}\n")
    print(f"{format_forecast(rows)}\n\n{path}")
