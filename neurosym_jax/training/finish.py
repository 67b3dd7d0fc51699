"""What a finished run leaves: `curves.png`, `run.json`, and `model/` with its card."""

from pathlib import Path
from typing import Any

import jax

from neurosym_jax.configuration import FORMAT
from neurosym_jax.forecasting.model import Model
from neurosym_jax.forecasting.model_folder import save_model
from neurosym_jax.runtime.environment import code_version
from neurosym_jax.runtime.files import write_json
from neurosym_jax.training.card import model_card

__all__ = ["RUN", "write_curves", "write_model"]

RUN = "run.json"


def write_model(
    folder: Path, model: Model, facts: dict[str, Any], validations: list[dict[str, Any]]
) -> None:
    """Write `run.json` and the model with its card, unless the model is there.

    Args:
        folder: of the run.
        model: the best by validation.
        facts: what else is known of the run, JSON-able.
        validations: a row each, with `val_score`.
    """
    if (folder / "model").exists():
        return
    facts = {
        "format": FORMAT,
        **facts,
        "parameters": sum(leaf.size for leaf in jax.tree.leaves(model.params)),
        "code": code_version(),
        "plugins": list(model.plugins),
        # The newest of equals, as the loop and the checkpoints choose.
        "validation": min(reversed(validations), key=lambda row: row["val_score"]),
    }
    write_json(folder / RUN, facts)
    # Last: a run that has a model is whole, whatever kills the process.
    save_model(folder / "model", model, model_card(facts))


def write_curves(folder: Path, history: list[dict[str, Any]]) -> None:
    """Losses of every round and errors of every validation as `curves.png`."""
    from neurosym_jax.plotting import plot_training, save_figure

    def curve(name: str) -> tuple[list[float], list[float]]:
        rows = [row for row in history if name in row]
        return [row["step"] for row in rows], [row[name] for row in rows]

    losses = [name for name in ("g_loss", "g_adversarial", "d_loss") if name in history[0]]
    figure = plot_training(
        {name: curve(name) for name in losses},
        {"ADE": curve("val_ade"), "FDE": curve("val_fde")},
        "training",
    )
    save_figure(figure, folder / "curves.png")
