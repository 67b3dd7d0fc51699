"""What a run came to, in words: its validation errors beside those of the baselines."""

from typing import Any

from neurosym_jax.data.batching import make_batches
from neurosym_jax.evaluation.plan import BASELINES, baseline
from neurosym_jax.evaluation.scoring import score_forecaster
from neurosym_jax.forecasting.model import Model
from neurosym_jax.training.run import Run

__all__ = ["outcome"]

ERRORS = ("joint_ade", "joint_fde")


def outcome(run: Run, model: Model) -> str:
    """A line for the model that was kept and one for each baseline, on the validation windows.

    They are of the windows that chose the state, so the model's are a little too good: what it is
    worth elsewhere, `evaluate` says.

    Raises:
        InputError: for a baseline that cannot forecast these windows.
    """
    config, samples = run.generator, run.recipe.best_k
    batches = make_batches(run.validation)
    others = [baseline(name, config.obs_len, config.pred_len) for name in BASELINES]
    lines = [f"on the {run.validation.scenes} validation scenes, joint best of {samples}, metres:"]
    width = max(len(each.name) for each in (model, *others))
    for each in (model, *others):
        how: dict[str, Any] = {"samples": samples, "seed": run.recipe.seed, "metrics": ERRORS}
        found = score_forecaster(each.forecaster, each.params, batches, **how)
        ade, fde = (found.mean(name) for name in ERRORS)
        lines.append(f"  {each.name:{width}}  ADE {ade:.3f}  FDE {fde:.3f}")
    return "\n".join(lines)
