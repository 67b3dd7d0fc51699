"""How much a weighting says on a data set: how alpha varies between pairs, and in time."""

import numpy as np

from neurosym_jax.data.batching import make_batches
from neurosym_jax.data.windows import Windows
from neurosym_jax.symbolic.weightings import make_weighting
from studies.weighting.scores import interacting

__all__ = ["interacting_share", "spread"]


def spread(windows: Windows, weighting: str) -> tuple[float, float]:
    """Coefficients of variation of alpha, between one's neighbours and from step to step.

    Between neighbours: of the last observed step, by agent, the mean over those with two or more.
    From step to step: by pair, the mean over pairs, of all steps but the first, which has no state.
    0 is a constant.
    """
    import jax

    weigh = jax.jit(jax.vmap(make_weighting(weighting)))
    between, in_time = [], []
    for batch in make_batches(windows):
        valid = np.asarray(batch.scene.valid)
        alpha = np.asarray(weigh(batch.scene.observed, valid), np.float64)
        others = valid[:, :, None] & valid[:, None] & ~np.eye(valid.shape[1], dtype=bool)
        steps = alpha[others][:, 1:]
        in_time.append(steps.std(axis=1) / steps.mean(axis=1))
        last, count = np.where(others, alpha[..., -1], 0), others.sum(axis=2)
        mean = last.sum(axis=2) / np.maximum(count, 1)
        variance = np.where(others, (last - mean[..., None]) ** 2, 0).sum(axis=2)
        some = count > 1
        between.append(np.sqrt(variance[some] / count[some]) / mean[some])
    return float(np.concatenate(between).mean()), float(np.concatenate(in_time).mean())


def interacting_share(windows: Windows) -> float:
    """Return the share of agents, over all windows, who interact."""
    found = [
        (interacting(np.asarray(batch.scene.observed), valid).sum(), valid.sum())
        for batch in make_batches(windows)
        for valid in [np.asarray(batch.scene.valid)]
    ]
    near, everybody = np.sum(found, axis=0)
    return float(near / everybody)
