"""Show a recording's QTC symbols and weights.

The states of a scene's pairs over time as text; alpha as a heat map over pairs and time; how often
each state occurs in all scenes, beside what it weighs; with a model, its forecast as a GIF in which
the width of a line is the weight of the pair.
"""

import dataclasses
from pathlib import Path
from typing import Annotated, Any

import jax
import numpy as np
import tyro

from neurosym_jax.checks import refuse_below
from neurosym_jax.data.batching import make_batches
from neurosym_jax.data.reading import AS_IT_SAYS, ReadOptions
from neurosym_jax.data.sources import open_source
from neurosym_jax.data.windows import Windows, cut_windows
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.model import Model, predict
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.scene import make_scene
from neurosym_jax.symbolic.states import decode_state, format_state
from neurosym_jax.symbolic.transitions import count_states, pair_codes
from neurosym_jax.symbolic.weighting import initial_parameters, scene_alpha
from neurosym_jax.symbolic.weighting_config import WEIGHTINGS, WeightingConfig
from neurosym_jax.training.run import named_weighting

__all__ = ["Options", "run"]

PERIOD = 0.4
CROWD = 5
"""People whose pairs can be told apart in a figure."""


@dataclasses.dataclass(frozen=True)
class Options:
    """Show the QTC symbols and weights of a recording, and of one of its scenes."""

    data: Annotated[Path | None, tyro.conf.Positional] = None
    """A recording, a folder of them or ETH/UCY; default: the embedded simulations."""
    scene: str | None = None
    """Which of the data's scenes (eth, hotel, ..., or a file's name); default: the first."""
    window: int | None = None
    """Number of the window that is shown; default: the first with the most people, up to five."""
    weighting: str | None = None
    """As train's; default: the model's, else cnd."""
    model: Path | None = None
    """A model, for its learned weights and its forecast."""
    obs_len: int = 8
    """Observed steps, where there is no model."""
    pred_len: int = 8
    """Steps after them, where there is no model."""
    out: Path = Path("results/symbols")
    """Folder for the figures."""
    read: Annotated[ReadOptions, tyro.conf.OmitArgPrefixes] = AS_IT_SAYS
    """How files are read."""


def run(options: Options) -> None:
    """Print and draw what `options` ask for.

    Raises:
        InputError: for data, a window, a weighting or a model that cannot be used.
    """
    refuse_below(1, {"obs-len": options.obs_len, "pred-len": options.pred_len})
    model = None if options.model is None else load_model(options.model)
    config, given = _weighting(options, model)
    lengths = (
        (options.obs_len, options.pred_len)
        if model is None
        else (model.config.obs_len, model.config.pred_len)
    )
    source = open_source(options.data, options.scene, read=options.read)
    name = options.scene or source.scenes[0]
    windows = cut_windows(source.recordings(name), *lengths)
    observed = [(b.scene.observed, b.scene.valid) for b in make_batches(windows)]
    parameters = initial_parameters(config, observed) if given is None else given
    number = _chosen(windows, options.window)
    rows = slice(*windows.bounds[number : number + 2])
    position, people = windows.position[rows], windows.agent[rows]

    scene = make_scene(position)
    codes = np.asarray(pair_codes(config, scene.observed, scene.valid))
    alpha = np.asarray(
        jax.jit(lambda positions: scene_alpha(config, parameters, positions))(scene.observed)
    )
    title = f"{name}, window {number}"
    print(f"{title}: {len(people)} people, weighting {config.name}\n\n{_chains(codes, people)}")
    counts = count_states(config, observed)
    print(f"\n{counts.sum()} observed pair-steps of {windows.scenes} windows:\n{_shares(counts)}")

    from neurosym_jax.plotting import save_figure
    from neurosym_jax.plotting.symbols import plot_pairs, plot_states

    texts = [format_state(state, "") for state in np.asarray(decode_state(np.arange(81)))]
    table, learned = _tables(config, parameters)
    figures = {
        "pairs.png": plot_pairs(position, people, codes, alpha, texts, title),
        "states.png": plot_states(counts, texts, table, learned, f"{name}, {config.name}"),
    }
    written = [save_figure(figure, options.out / file) for file, figure in figures.items()]
    if model is not None:
        from neurosym_jax.plotting.animation import animate_forecast

        obs_len = lengths[0]
        forecast = predict(model, position[:, :obs_len])
        path = options.out / "forecast.gif"
        seen = alpha[..., :obs_len]
        words = f"{title}: forecast of {model.name}; lines: {config.name}"
        animate_forecast(path, position, forecast, seen, words)
        written.append(path)
    print("\n" + "\n".join(map(str, written)))


def _weighting(
    options: Options, model: Model | None
) -> tuple[WeightingConfig, dict[str, Any] | None]:
    """The weighting, and its parameters where a model has them."""
    if model is None or options.weighting is not None:
        return named_weighting(options.weighting or "cnd"), None
    if model.weighting is None:
        raise InputError(f"{options.model}: {model.name} weighs no pairs; say --weighting as well")
    return model.weighting, model.params.get("weighting", {})


def _chosen(windows: Windows, asked: int | None) -> int:
    if asked is None:
        sizes = np.where(windows.sizes <= max(CROWD, windows.sizes.min()), windows.sizes, 0)
        return int(sizes.argmax())
    if not 0 <= asked < windows.scenes:
        raise InputError(f"--window must lie in [0, {windows.scenes}), not {asked}")
    return asked


def _tables(
    config: WeightingConfig, parameters: dict[str, Any]
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """[81] weights by state before and after training, where the weighting has any."""
    table = WEIGHTINGS[config.kind].table
    return (None, None) if table is None else (table(config), parameters.get("table"))


def _chains(codes: np.ndarray, people: np.ndarray) -> str:
    """A line for every unordered pair: its states from step to step, `.` where they stay."""
    steps = codes.shape[-1]
    head = [f"{PERIOD * (step + 1):>5.1f}" for step in range(steps)]
    lines = ["pair (k, l)     s " + " ".join(head)]
    for i in range(len(people)):
        for j in range(i + 1, len(people)):
            states = np.asarray(decode_state(codes[i, j]))
            texts = [
                "." if step and (states[step] == states[step - 1]).all() else format_state(s, "")
                for step, s in enumerate(states)
            ]
            pair = f"({people[i]}, {people[j]})"
            lines.append(f"{pair:18}" + " ".join(f"{text:>5}" for text in texts))
    return "\n".join(lines)


def _shares(counts: np.ndarray) -> str:
    """Per cent of the pair-steps by how many of their symbols are 0."""
    zeros = (np.asarray(decode_state(np.arange(81))) == 0).sum(axis=1)
    shares = 100 * np.bincount(zeros, counts, 5) / counts.sum()
    words = ("no symbol is 0", "one", "two", "three", "all")
    return ", ".join(f"{word} {share:.1f} %" for word, share in zip(words, shares))
