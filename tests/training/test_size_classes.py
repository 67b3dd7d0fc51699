import itertools

import numpy as np
import pytest

from neurosym_jax.training import size_classes as module
from neurosym_jax.training.size_classes import quota, size_classes


def cost(classes, sizes, batch_scenes):
    members = np.bincount(np.searchsorted(classes, sizes), minlength=len(classes))
    pairs = quota(members, len(sizes), batch_scenes) * np.square(classes)
    return pairs.sum() + module.COST_OF_A_CLASS * len(classes)


@pytest.mark.parametrize("seed", range(5))
def test_no_other_classes_cost_less(seed):
    sizes = np.random.default_rng(seed).choice([2, 3, 9, 14, 40, 65], 300)
    values = np.unique(sizes)
    found = size_classes(sizes, 64)
    assert found[-1] == values[-1]
    subsets = itertools.chain.from_iterable(
        itertools.combinations(values[:-1], count) for count in range(len(values))
    )
    costs = [cost(np.array([*subset, values[-1]]), sizes, 64) for subset in subsets]
    assert cost(found, sizes, 64) == min(costs)


def test_a_few_small_scenes_make_one_class():
    assert size_classes(np.array([2, 2, 2, 2, 3]), 4).tolist() == [3]
