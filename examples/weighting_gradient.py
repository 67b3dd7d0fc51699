"""How the weights of a pair change with the threshold and the temperature of its symbols.

python examples/weighting_gradient.py
"""

import jax
import numpy as np

import neurosym_jax as nj

steps = np.arange(8)[:, None]
# [2, 8, 2] metres
positions = np.stack([steps * [0.4, 0.0], [3.0, 0.5] - steps * [0.02, 0.0]])
soft = nj.symbolic.Soft(learned=True)
start = nj.symbolic.initial_parameters(soft)
alpha = jax.jit(
    lambda learned: nj.symbolic.make_weighting(soft, learned)(positions)[0, 1, -1]
)
print(f"alpha {alpha(start):.4f}")
for name, gradient in jax.grad(alpha)(start).items():
    print(f"its gradient by {name}: {np.abs(gradient).max():.4g}")
