"""A real scheduler and worker: tasks have the caller's plugins, and rows are the same."""

import sys

import numpy as np
import pytest

from neurosym_jax.data.tracks import make_tracks
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.plan import TestSet as Case
from neurosym_jax.evaluation.plan import baseline, make_test
from neurosym_jax.evaluation.results import Settings, evaluate_tests
from neurosym_jax.plugins import load_plugin
from neurosym_jax.runtime.cluster import cluster_map

distributed = pytest.importorskip("distributed")


@pytest.mark.slow
def test_tasks_have_plugins_and_rows_are_the_same(tmp_path, monkeypatch):
    monkeypatch.setattr("neurosym_jax.plugins._loaded", {})  # Not the plugins of other tests.
    (tmp_path / "doubling.py").write_text("def double(x):\n    return 2 * x\n")
    load_plugin(str(tmp_path / "doubling.py"))
    double = next(m for n, m in sys.modules.items() if n.startswith("doubling_")).double
    stamp, person = np.divmod(np.arange(40), 2)
    tracks = make_tracks("walk", stamp * 0.4, person, np.stack([stamp, 1.0 * person], 1))
    entries = [(None, baseline("constant_velocity_sampled", 4, 2))]
    tests = [make_test(Case(name, 4, 2), entries, [tracks]) for name in "ab"]
    settings = Settings(samples=2)
    here = {"n_workers": 1, "threads_per_worker": 1, "dashboard_address": None}
    with distributed.LocalCluster(**here) as cluster, cluster_map(cluster.scheduler_address) as run:
        assert list(run(double, [21, 4])) == [42, 8]
        found = list(evaluate_tests(tests, settings, run))
    assert [result.test_set.dataset for result in found] == ["a", "b"]
    for result, other in zip(found, evaluate_tests(tests, settings), strict=True):
        for name in ("joint_ade", "joint_ade_low", "joint_ade_high"):
            assert result.row[name] == pytest.approx(other.row[name])


def test_no_scheduler():
    with pytest.raises(InputError, match="nowhere: no Dask scheduler"), cluster_map("nowhere"):
        pass
