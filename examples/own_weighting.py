"""Swap in a weighting of one's own: whoever is near matters, and how near is learned.

    python examples/own_weighting.py

Trains two small models on the simulations, one with `cnd` and one with `nearness`, and compares
them. From the command line the same weighting is called by module and kind:

    PYTHONPATH=examples python train.py --model neurosym --weighting own_weighting:nearness
"""

import dataclasses
import tempfile
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from neurosym_jax.symbolic import register_weighting
from neurosym_jax.training.loop import train_run
from neurosym_jax.training.run import TrainOptions, make_run


@register_weighting("nearness", log_reach=0.0)
def nearness(positions, valid, log_reach):
    """[N, N, T]: 1 for those on one spot, less the farther two are apart."""
    apart = positions[:, None] - positions[None]  # [N, N, T, 2]
    square = (apart * apart).sum(axis=-1)
    return jnp.exp(-square / jnp.exp(2 * log_reach))


def main(steps: int = 100) -> float:
    """Print both errors and what was learned; returns the reach in metres."""
    reach = 1.0
    for weighting in ("cnd", "nearness"):
        options = TrainOptions(
            model="neurosym",
            weighting=weighting,
            scene="cross-path",
            steps=steps,
            set=("batch_scenes=16", "best_k=5", f"validate_every={steps}"),
        )
        run = make_run(options)
        # Narrow, so that it is quick.
        run = dataclasses.replace(
            run, generator=dataclasses.replace(run.generator, pool_hidden_dim=64)
        )
        with tempfile.TemporaryDirectory() as folder:
            model = train_run(run, Path(folder) / "run")
            (last,) = (
                line
                for line in (Path(folder) / "run" / "metrics.jsonl").read_text().splitlines()
                if "val_ade" in line
            )
        print(f"{model.name} after {steps} steps: {last}")
        if weighting == "nearness":
            reach = float(np.exp(model.params["weighting"]["log_reach"]))
    print(f"people matter within about {reach:.2f} m")
    return reach


if __name__ == "__main__":
    main()
