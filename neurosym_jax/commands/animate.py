"""Animate the forecasts of a recording.

Each picture has one step: people who have been seen for the model's observed steps, and
what they may do next, drawn from its distribution.
"""

from pathlib import Path

import numpy as np

from neurosym_jax.commands._options import Positional, Reading, open_data
from neurosym_jax.configuration import Count, Seed, refuse
from neurosym_jax.data.tables import AS_IT_SAYS
from neurosym_jax.data.windows import Windows, cut_windows
from neurosym_jax.errors import InputError
from neurosym_jax.models.disk import find_model, load_model
from neurosym_jax.models.forecast import Model, predict_distribution
from neurosym_jax.runtime.files import refuse_unwritable

__all__ = ["run"]


def run(
    data: Positional[Path | None] = None,
    dataset: str | None = None,
    window: int | None = None,
    pictures: int = 40,
    model: Path = Path("recommended"),
    pred_len: int | None = None,
    draws: int = 20,
    seed: int = 0,
    out: Path = Path("results/forecasts.gif"),
    read: Reading = AS_IT_SAYS,
) -> None:
    """Animate what people may do next, step by step.

    Args:
        data: Recording, folder of them, or ETH/UCY; default: embedded simulations.
        dataset: Data set (eth, hotel, ..., or a file's name); default: the first.
        window: Index of the first window; default: where most people are.
        pictures: Number of steps that are shown.
        model: Model by name, folder or .pt file.
        pred_len: Number of steps to forecast; default: the model's.
        draws: Number of futures of each person.
        seed: Random seed of the draws.
        out: File to write, .gif or .mp4.
        read: How files are read.

    Raises:
        InputError: for data, a window, a model or a file that cannot be used.
    """
    from neurosym_jax.plotting import Moment, plot_animation, save_animation
    from neurosym_jax.plotting.animation import check_animation

    refuse(Count, {"--draws": draws, "--pictures": pictures})
    refuse(Seed, {"--seed": seed})
    check_animation(out)
    refuse_unwritable(out)
    network = load_model(find_model(model, dataset, pred_len))
    if pred_len not in (None, network.config.pred_len):
        raise InputError(
            f"--pred-len {pred_len}: {model} has {network.config.pred_len}"
        )
    period = network.config.period
    source = open_data(data, read, dataset, period=period)
    name = dataset or source.scenes[0]
    # Nobody is left out who is seen no longer than the forecast.
    windows = cut_windows(
        source.recordings(name), network.config.obs_len, 1, min_agents=1
    )
    first = _busiest(windows, pictures) if window is None else window
    if not 0 <= first < windows.scenes:
        raise InputError(f"--window must lie in [0, {windows.scenes}), not {first}")
    moments = [
        Moment(*_forecast(network, windows, number, draws, seed))
        for number in _following(windows, first, pictures)
    ]
    seconds = network.config.pred_len * period
    title = f"{name}: the next {seconds:.1f} s, by {model.stem}"
    animation = plot_animation(moments, period, title)
    save_animation(animation, out, period)
    print(f"{len(moments)} steps of {period:g} s: {out}")


def _forecast(
    network: Model, windows: Windows, number: int, draws: int, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ids [N] of a window, observed [N, obs_len, 2] and futures [n, N, pred_len, 2], metres."""
    scene = windows.take(slice(number, number + 1))
    observed = scene.position[:, :-1]
    futures = predict_distribution(network, observed, draws=draws, seed=seed)
    return scene.agent, observed, futures


def _busiest(windows: Windows, count: int) -> int:
    """The first of `count` windows that show most people."""
    total = np.concatenate([[0], np.cumsum(windows.sizes)])
    count = min(count, windows.scenes)
    return int((total[count:] - total[:-count]).argmax())


def _following(windows: Windows, first: int, count: int) -> range:
    """Up to `count` windows of one recording, each a step after the one before."""
    last = first + 1
    while last < min(first + count, windows.scenes):
        before, after = windows.identity[last - 1 : last + 1]
        if after[0] != before[0] or after[1] != before[1] + 1:
            break
        last += 1
    return range(first, last)
