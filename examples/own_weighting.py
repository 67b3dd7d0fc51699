"""Swap in a weighting of your own: near people matter more, and the distance is learned.

    python examples/own_weighting.py

Trains two small models on the simulations, one with `cnd` and one with `nearness`, and
compares them. On the command line this file is a plugin:

    python train.py --plugin examples/own_weighting.py --family neurosym --weighting nearness
"""

import tempfile
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from neurosym_jax.data.recordings import open_source
from neurosym_jax.symbolic import register_weighting
from neurosym_jax.training.loop import train
from neurosym_jax.training.run import make_config, make_recipe


@register_weighting("nearness", log_reach=0.0)
def nearness(positions, valid, log_reach):
    """[N, N, T]: 1 for those on one spot, less the farther two are apart."""
    offset = positions[:, None] - positions[None]  # [N, N, T, 2]
    square = (offset * offset).sum(axis=-1)
    return jnp.exp(-square / jnp.exp(2 * log_reach))


def main(steps: int = 100, weightings: tuple[str, ...] = ("cnd", "nearness")) -> float:
    """Print both errors and what was learned; returns the reach in metres."""
    reach = 1.0
    source = open_source(None)
    training, validation = (
        source.recordings("cross-path", split) for split in ("train", "val")
    )
    changes = ("batch_scenes=16", "best_k=5", f"validate_every={steps}")
    recipe = make_recipe("ours", steps=steps, changes=changes)
    for weighting in weightings:
        # Narrow, so that it is quick.
        narrow = ("pooling.hidden_dim=64",)
        config = make_config("neurosym", changes=[f"weighting={weighting}", *narrow])
        with tempfile.TemporaryDirectory() as folder:
            run = Path(folder) / "run"
            model = train(training, validation, run, config=config, recipe=recipe)
            last = (run / "metrics.jsonl").read_text().splitlines()[-1]
        print(f"{model.name} after {steps} steps: {last}")
        if weighting == "nearness":
            reach = float(np.exp(model.params["weighting"]["log_reach"]))
    print(f"people matter within about {reach:.2f} m")
    return reach


if __name__ == "__main__":
    main()
