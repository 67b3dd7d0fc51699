"""What a finished run leaves: `curves.png`, `run.json`, and `model/` with its card."""

import json
import shutil
from pathlib import Path
from typing import Any

import jax

from neurosym_jax.config import FORMAT
from neurosym_jax.forecasting.model import Model
from neurosym_jax.forecasting.model_folder import save_model
from neurosym_jax.runtime.environment import code_version
from neurosym_jax.training.card import CARD, write_card

__all__ = ["RUN", "write_curves", "write_model"]

RUN = "run.json"


def write_model(
    folder: Path, model: Model, facts: dict[str, Any], validations: list[dict[str, Any]]
) -> None:
    """Write `run.json`, the model and its card, as far as they are not there.

    Args:
        folder: of the run.
        model: the best by validation.
        facts: what else is known of the run, JSON-able.
        validations: a row each, with `val_score`.
    """
    target, part = folder / "model", folder / "model.part"
    if (target / CARD).exists():
        return
    facts = {
        "format": FORMAT,
        **facts,
        "parameters": sum(leaf.size for leaf in jax.tree.leaves(model.params)),
        "code": code_version(),
        # The newest of equals, as the loop and the checkpoints choose.
        "validation": min(reversed(validations), key=lambda row: row["val_score"]),
    }
    (folder / RUN).write_text(json.dumps(facts, indent=1) + "\n")
    if not target.exists():
        shutil.rmtree(part, ignore_errors=True)
        save_model(part, model)
        # Renamed into place: a run that has a model is whole, whatever kills the process.
        part.rename(target)
    write_card(target, facts)


def write_curves(folder: Path, history: list[dict[str, Any]]) -> None:
    """Losses of every round and errors of every validation as `curves.png`."""
    from neurosym_jax.plotting.figures import plot_training, save_figure

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
