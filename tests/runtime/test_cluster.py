"""A real cluster of two workers: nothing is lost when one is killed, and the bits are the same."""

import os
import pickle
import sys
from pathlib import Path

import pytest

from neurosym_jax.data.sources import open_source
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation import plan
from neurosym_jax.evaluation.cluster import evaluator
from neurosym_jax.evaluation.load import load_tests
from neurosym_jax.evaluation.plan import baseline
from neurosym_jax.evaluation.run import Settings
from neurosym_jax.runtime.cluster import over_cluster

pytest.importorskip("distributed", reason="a cluster needs the extra cluster")

ROOT = Path(__file__).parents[2]
ENV = {**os.environ, "NPROC": "1", "PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu"}


def constant_velocity_on(*datasets):
    """Constant velocity on simulations."""
    entries = [(None, baseline("constant_velocity", 8, 8))]
    return load_tests(open_source(None), {plan.TestSet(name, 8, 8): entries for name in datasets})


def test_results_come_in_the_order_of_the_tests(monkeypatch):
    def backwards(address, work, items):
        """A worker does the last item first."""
        assert address == "tcp://there"
        for place in reversed(range(len(items))):
            yield place, work(pickle.loads(pickle.dumps(items[place]))), ""

    monkeypatch.setattr("neurosym_jax.evaluation.cluster.over_cluster", backwards)
    tests = constant_velocity_on("cross-path", "all-forward")
    found, alone = (list(evaluator(at)(tests, Settings(samples=2))) for at in ("tcp://there", None))
    assert [each.test_set.dataset for each in found] == ["cross-path", "all-forward"]
    assert [each.row["metrics"] for each in found] == [each.row["metrics"] for each in alone]


def test_a_test_set_that_failed_is_named(monkeypatch):
    def failing(address, work, items):
        yield 0, None, "the workers that were at it died, one after another"

    monkeypatch.setattr("neurosym_jax.evaluation.cluster.over_cluster", failing)
    with pytest.raises(InputError, match="cross-path: the workers that were at it died"):
        list(evaluator("tcp://there")(constant_velocity_on("cross-path"), Settings()))


def test_what_is_not_there_is_said(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="--cluster nowhere://x: no Dask scheduler answers"):
        list(over_cluster("nowhere://x", len, [()]))
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match="--cluster needs Dask: pip install"):
        list(over_cluster("tcp://there", len, [()]))
