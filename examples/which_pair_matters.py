"""Which pair matters most to a forecast? Its error, differentiated with respect to alpha.

    python examples/which_pair_matters.py

Four people: 1 and 2 walk together, 3 comes towards them, 4 stands aside. 1 and 2 will
step aside. The gradient of the forecast's error by the weight of each pair, times a
hundredth of that weight, is what the error changes by when the pair weighs one per cent
more. Beside it stands what it really changes by. A pair that changes nothing never
holds the maximum over neighbours that pooling takes.
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from neurosym_jax import forecast, load_model
from neurosym_jax.models.sgan.training import warn_if_no_gradient
from neurosym_jax.symbolic import make_weighting

MODEL = Path(__file__).resolve().parents[1] / "checkpoints" / "neurosym_zara1_8"
SAMPLES = 20


def main(path: Path = MODEL) -> np.ndarray:
    """Print the pairs in order; returns what they change, foretold and found, [2, pairs] metres."""
    model = load_model(path)
    config, params = model.config, model.params
    observed, future = meeting()
    noise = jax.random.normal(jax.random.key(0), (SAMPLES, config.noise_dim))

    def error(alpha: jax.Array) -> jax.Array:
        """ADE in metres, mean over people and samples."""
        made = forecast(config, params, observed, noise, alpha)
        return jnp.linalg.norm(made - future, axis=-1).mean()

    alpha = make_weighting(config.weighting)(jnp.asarray(observed, jnp.float32))
    value, gradient = jax.jit(jax.value_and_grad(error))(alpha)
    warn_if_no_gradient(gradient, "alpha")
    pairs = [(i, j) for i in range(4) for j in range(4) if i != j]
    foretold = np.array([0.01 * (gradient[pair] * alpha[pair]).sum() for pair in pairs])
    raised = np.stack([np.asarray(alpha).copy() for _ in pairs])
    for case, pair in zip(raised, pairs):
        case[pair] *= 1.01
    changes = np.asarray(jax.jit(jax.vmap(error))(raised)) - float(value)

    print(
        f"{model.name}: ADE {float(value):.3f} m. One per cent more weight changes it, in mm:"
    )
    for at in np.argsort(-abs(foretold), kind="stable"):
        i, j = pairs[at]
        line = f"{1000 * foretold[at]:+7.3f} by the gradient, {1000 * changes[at]:+7.3f} in fact"
        print(f"  {j + 1} as seen by {i + 1}: {line}")
    return np.stack([foretold, changes])


def meeting() -> tuple[np.ndarray, np.ndarray]:
    """Positions [4, 8, 2] metres observed and [4, 8, 2] afterwards, 0.4 s apart."""
    step = np.arange(16)
    east, west = 0.5 * step, 12 - 0.5 * step
    aside = -0.12 * np.maximum(step - 7, 0)
    people = [
        np.stack([east, 0.0 + aside], axis=1),
        np.stack([east, -0.8 + aside], axis=1),
        np.stack([west, 0.1 + 0 * west], axis=1),
        np.stack([6 + 0 * east, 3 + 0 * east], axis=1),
    ]
    positions = np.stack(people)
    return positions[:, :8], positions[:, 8:]


if __name__ == "__main__":
    main()
