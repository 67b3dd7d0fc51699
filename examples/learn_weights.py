"""Learn the 81 weights of a trained network, and nothing else of it.

    python examples/learn_weights.py

NeuroSyM as it ships for the simulations was trained with `cnd`. Here its network stays as it is and
the table becomes free: gradients of the variety loss flow through the network into the weights.
"""

import dataclasses
from pathlib import Path
from typing import Any

import jax
import numpy as np
import optax

from neurosym_jax import load_model
from neurosym_jax.data.batching import make_batches
from neurosym_jax.data.sources import Synthetic
from neurosym_jax.data.windows import cut_windows
from neurosym_jax.evaluation.scoring import score_forecaster
from neurosym_jax.forecasting.networks import GeneratorForecaster
from neurosym_jax.symbolic import Learned, alpha_table
from neurosym_jax.symbolic.description import state_texts
from neurosym_jax.symbolic.weighting import initial_parameters
from neurosym_jax.training.gradients import generator_gradient, warn_if_no_gradient
from neurosym_jax.training.recipe import TrainConfig
from neurosym_jax.training.rollout import draw_group_noise
from neurosym_jax.training.stream import SceneStream

MODEL = Path(__file__).resolve().parents[1] / "checkpoints" / "neurosym_simulations_8"


def main(path: Path = MODEL, steps: int = 100, learning_rate: float = 0.003) -> np.ndarray:
    """Print errors before and after, and the weights that changed most; returns the table [81]."""
    model = load_model(path)
    config = dataclasses.replace(model.config, weighting=Learned())
    network = model.params
    weights: Any = initial_parameters(config.weighting)
    training, test = (
        cut_windows(Synthetic().recordings("cross-path", split), 8, 8)
        for split in ("train", "test")
    )
    stream = SceneStream(training, batch_scenes=32, seed=0)
    recipe = TrainConfig(best_k=10)
    optimizer = optax.adam(learning_rate)

    @jax.jit
    def step(weights: Any, state: Any, groups: Any, key: jax.Array):
        noise = draw_group_noise(config, groups, key, recipe.best_k)
        params = {**network, "weighting": weights}
        gradient, metrics = generator_gradient(config, recipe, params, (), groups, noise, label=1.0)
        update, state = optimizer.update(gradient["weighting"], state)
        return optax.apply_updates(weights, update), state, metrics["g_variety"], gradient

    def report(when: str) -> None:
        params = {**network, "weighting": weights}
        found = score_forecaster(
            GeneratorForecaster(config),
            params,
            make_batches(test),
            samples=20,
            seed=0,
            metrics=("joint_ade", "joint_fde"),
        )
        ade, fde = found.mean("joint_ade"), found.mean("joint_fde")
        print(f"{when}: ADE {ade:.3f} m, FDE {fde:.3f} m, joint best of 20 on the test split")

    report("with the table")
    state, key = optimizer.init(weights), jax.random.key(0)
    for number in range(steps):
        groups = jax.tree.map(lambda leaf: leaf[0], stream.steps(number, 1))
        weights, state, loss, gradient = step(
            weights, state, groups, jax.random.fold_in(key, number)
        )
        if number % 25 == 0:
            print(f"  step {number}: loss {float(loss):.3f}")
            warn_if_no_gradient(gradient["weighting"], "the weights")
    report("with learned weights")

    table = np.asarray(weights["table"])
    change = table - alpha_table()
    for code in np.argsort(-abs(change))[:5]:
        text = state_texts()[code]
        print(f"  {text}: {alpha_table()[code]:.3f} became {table[code]:.3f}")
    return table


if __name__ == "__main__":
    main()
