"""Runs an exported model without neurosym_jax: jax and flatbuffers are enough.

neurosym export MODEL model.stablehlo
python examples/run_exported.py model.stablehlo
"""

import sys
from pathlib import Path

import jax.export
import numpy as np


def main(path: str, people: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Forecasts [k, people, pred_len, 2] metres, and probabilities [k], of people side by side."""
    program = jax.export.deserialize(bytearray(Path(path).read_bytes()))
    steps = program.in_avals[0].shape[1]
    walks = np.linspace([0, 0], [2, 0], steps) + np.arange(people)[:, None, None]
    rng, inputs = np.random.default_rng(0), [walks]
    for noise in program.in_avals[1:]:  # None for a model without noise.
        inputs += [
            rng.normal(size=[s if isinstance(s, int) else people for s in noise.shape])
        ]
    forecasts, probabilities = program.call(
        *(np.asarray(x, np.float32) for x in inputs)
    )
    print(
        f"{forecasts.shape[0]} futures of {people} people, {forecasts.shape[2]} steps"
    )
    return np.asarray(forecasts), np.asarray(probabilities)


if __name__ == "__main__":
    main(sys.argv[1])
