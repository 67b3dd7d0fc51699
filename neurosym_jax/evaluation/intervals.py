"""How certain the means of one model on one test set are: intervals over its scenes.

Scenes are drawn in blocks, see `paired`; what other training seeds would have given is `summary`'s.
"""

import dataclasses

import numpy as np

from neurosym_jax.evaluation.paired import ErrorsByScene, paired_difference

__all__ = ["block_intervals"]


def block_intervals(errors: ErrorsByScene) -> dict[str, list[float]]:
    """By metric the bounds of the 95 % interval of its mean: what other scenes would have given."""
    nothing = dataclasses.replace(errors, totals=np.zeros_like(errors.totals))
    # A model's errors are the difference from no error at all.
    difference = paired_difference([errors], [nothing])
    intervals = {name: difference.intervals(name)["scenes"] for name in errors.metrics}
    return {name: list(interval) for name, interval in intervals.items() if interval is not None}
