"""The results of a finished run: `curves.png`, `run.json`, `model/`, and its errors in words."""

from pathlib import Path
from typing import Any

import jax

from neurosym_jax.data.batching import make_batches
from neurosym_jax.evaluation.scoring import score_forecaster
from neurosym_jax.evaluation.test_sets import baselines_of
from neurosym_jax.forecasting.model import Model
from neurosym_jax.forecasting.model_folder import save_model
from neurosym_jax.runtime.environment import code_version
from neurosym_jax.runtime.files import write_json
from neurosym_jax.training.card import model_card
from neurosym_jax.training.run import Run

__all__ = ["RUN", "best_of", "outcome", "write_curves", "write_model"]

RUN = "run.json"


def write_model(
    folder: Path, model: Model, facts: dict[str, Any], validations: list[dict[str, Any]]
) -> None:
    """Write `run.json` and the model with its card, unless the model is there.

    Args:
        folder: of the run.
        model: the best by validation.
        facts: other facts of the run, JSON-able.
        validations: a row each, with `val_score`.
    """
    if (folder / "model").exists():
        return
    facts = {
        "format": 1,
        **facts,
        "parameters": sum(leaf.size for leaf in jax.tree.leaves(model.params)),
        "code": code_version(),
        "plugins": list(model.plugins),
        "validation": best_of(validations),
    }
    write_json(folder / RUN, facts)
    # Last: a run that has a model is whole, whatever kills the process.
    save_model(folder / "model", model, model_card(facts))


def best_of(validations: list[dict[str, Any]]) -> dict[str, Any]:
    """The row of the state that is kept: the newest of equals, as the checkpoints choose."""
    return min(reversed(validations), key=lambda row: row["val_score"])


def write_curves(folder: Path, history: list[dict[str, Any]]) -> None:
    """Draw the losses of every round and the errors of every validation as `curves.png`."""
    from neurosym_jax.plotting import plot_training, save_figure

    def curve(name: str) -> tuple[list[float], list[float]]:
        rows = [row for row in history if name in row]
        return [row["step"] for row in rows], [row[name] for row in rows]

    losses = [name for name in ("loss", "g_loss", "g_adversarial", "d_loss") if name in history[0]]
    figure = plot_training(
        {name: curve(name) for name in losses},
        {"ADE": curve("val_ade"), "FDE": curve("val_fde")},
        "training",
    )
    save_figure(figure, folder / "curves.png")


def outcome(run: Run, model: Model) -> str:
    """The validation errors of the model and of each baseline, a line each.

    The validation windows chose the model's state, so its errors are a little too good.

    Raises:
        InputError: for a baseline that cannot forecast these windows.
    """
    config, samples = run.network, run.samples
    batches = make_batches(run.validation)
    of = baselines_of(None, config.obs_len, config.pred_len, run.dataset, samples)
    models = [model, *(each for _, each in of)]
    lines = [f"on the {run.validation.scenes} validation scenes, joint best of {samples}, metres:"]
    width = max(len(each.name) for each in models)
    for each in models:
        found = score_forecaster(
            each.forecaster,
            each.params,
            batches,
            samples=samples,
            seed=run.recipe.seed,
            metrics=("joint_ade", "joint_fde"),
        )
        ade, fde = found.mean("joint_ade"), found.mean("joint_fde")
        lines.append(f"  {each.name:{width}}  ADE {ade:.3f}  FDE {fde:.3f}")
    return "\n".join(lines)
