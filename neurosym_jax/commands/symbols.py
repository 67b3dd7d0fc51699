"""Show a recording's QTC symbols and weights.

States of a scene's pairs over time as text; alpha as a heat map over pairs and time; the frequency
of each state in all scenes, and its weight. With --forecast, the probabilities of the pairs' events
and states in the model's samples, as text, JSON lines and a figure.
"""

import dataclasses
import json
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from neurosym_jax.configuration import Count, Seed, refuse
from neurosym_jax.data.batching import make_batches
from neurosym_jax.data.reading import AS_IT_SAYS, ReadOptions
from neurosym_jax.data.sources import open_source
from neurosym_jax.data.windows import Windows, cut_windows
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.model import Model, predict
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.runtime.files import write_text
from neurosym_jax.symbolic.description import (
    describe_pairs,
    forecast_pairs,
    forecast_rows,
    format_forecast,
    format_pairs,
    format_shares,
)
from neurosym_jax.symbolic.forecast import SymbolSettings
from neurosym_jax.symbolic.transition import count_states
from neurosym_jax.symbolic.weighting import Weighting, initial_parameters
from neurosym_jax.training.network import named_weighting

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
    """Model whose weights or, with --forecast, forecast are shown."""
    forecast: bool = False
    """Show instead the model's forecast of the pairs: events and states with probabilities."""
    calculus: str = "c1"
    """Calculus of the forecast states: b1, c1 or bc1 (docs/symbols.md)."""
    speed: float = 0.125
    """Speed below which a forecast movement counts as standing, m/s."""
    at_least: float = 0.3
    """Least probability of the events that are printed."""
    samples: int = 20
    """Number of forecasts of the scene, k."""
    seed: int = 0
    """Random seed of the noise."""
    obs_len: int = 8
    """Number of observed steps, without a model."""
    pred_len: int = 8
    """Number of steps after them, without a model."""
    out: Path = Path("results/symbols")
    """Folder of the figures."""
    image: Literal["png", "pdf", "svg"] = "png"
    """Format of the figures; --format is that of the files read."""
    read: Annotated[ReadOptions, tyro.conf.OmitArgPrefixes] = AS_IT_SAYS
    """How files are read."""


def run(options: Options) -> None:
    """Print and draw as `options` say.

    Raises:
        InputError: for data, a window, a weighting or a model that cannot be used.
    """
    refuse(Count, {"obs-len": options.obs_len, "pred-len": options.pred_len})
    refuse(Count, {"samples": options.samples})
    refuse(Seed, {"--seed": options.seed})
    model = (
        None
        if options.model is None
        else load_model(options.model, dataset=options.dataset, pred_len=options.pred_len)
    )
    if options.forecast:
        if model is None:
            raise InputError("--forecast needs a --model that forecasts")
        _forecast(options, model)
        return
    weighting, given = _weighting(options, model)
    lengths = model.config if model is not None else options
    name, title, windows, rows = _shown(options, lengths.obs_len, lengths.pred_len)
    observed = [(b.scene.observed, b.scene.valid) for b in make_batches(windows)]
    parameters = initial_parameters(weighting, observed) if given is None else given
    scene = windows.position[rows], windows.agent[rows], windows.period
    pairs = describe_pairs(weighting, parameters, *scene)
    counts = count_states(weighting, parameters, observed)

    print(f"{title}: {len(pairs.people)} people, weighting {weighting.name}\n")
    print(format_pairs(pairs))
    hint = " is constant here; try --weighting quantised" if pairs.constant else ""
    if hint:
        print(f"\n{weighting.name}{hint}")
    print(f"\n{counts.sum()} observed pair-steps of {windows.scenes} windows:")
    print(format_shares(counts))

    from neurosym_jax.plotting import plot_pairs, plot_states, save_figure

    table = weighting.state_weights()
    learned = None if table is None else parameters.get("table")
    written = [
        save_figure(figure, options.out / f"{kind}.{options.image}")
        for kind, figure in {
            "pairs": plot_pairs(pairs, f"{title}, {weighting.name}{hint}"),
            "states": plot_states(counts, table, learned, f"{name}, {weighting.name}"),
        }.items()
    ]
    print("\n" + "\n".join(map(str, written)))


def _forecast(options: Options, model: Model) -> None:
    """Print, write and draw the model's forecast of the window."""
    _, title, windows, rows = _shown(options, model.config.obs_len, model.config.pred_len)
    observed, people = windows.position[rows, : windows.obs_len], windows.agent[rows]
    samples = predict(model, observed, samples=options.samples, seed=options.seed)
    how = SymbolSettings(windows.period, options.calculus, speed=options.speed)
    found = forecast_pairs(samples, observed, people, how)
    print(f"{title}: {len(people)} people, {len(samples)} samples of {model.name}\n")
    print(format_forecast(found, options.at_least))
    lines = [json.dumps(row, allow_nan=False) for row in forecast_rows(found)]
    path = options.out / "forecast.jsonl"
    write_text(path, "\n".join(lines) + "\n")

    from neurosym_jax.plotting import plot_symbol_forecast, save_figure

    figure = plot_symbol_forecast(observed, samples, found, title)
    drawn = save_figure(figure, options.out / f"forecast.{options.image}")
    print(f"\n{path}\n{drawn}")


def _weighting(options: Options, model: Model | None) -> tuple[Weighting, dict[str, Any] | None]:
    """The weighting, and its parameters where a model has them."""
    if model is None or options.weighting is not None:
        return named_weighting(options.weighting or "cnd"), None
    if model.config.weighting is None:
        raise InputError(f"{options.model}: {model.name} weighs no pairs: name a --weighting")
    return model.config.weighting, model.params.get("weighting", {})


def _shown(options: Options, obs_len: int, pred_len: int) -> tuple[str, str, Windows, slice]:
    """Names of the data set and of the window shown, all windows, and its agent windows."""
    source = open_source(options.data, options.dataset, read=options.read)
    name = options.dataset or source.scenes[0]
    windows = cut_windows(source.recordings(name), obs_len, pred_len)
    number = _chosen(windows, options.window)
    rows = slice(*windows.bounds[number : number + 2])
    return name, f"{name}, window {number}", windows, rows


def _chosen(windows: Windows, asked: int | None) -> int:
    """The index of the window to show."""
    if asked is None:
        sizes = np.where(windows.sizes <= max(CROWD, windows.sizes.min()), windows.sizes, 0)
        return int(sizes.argmax())
    if not 0 <= asked < windows.scenes:
        raise InputError(f"--window must lie in [0, {windows.scenes}), not {asked}")
    return asked
