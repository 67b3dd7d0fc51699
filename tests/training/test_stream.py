import dataclasses

import jax
import numpy as np
import pytest

from neurosym_jax.training.gradients import draw_group_noise
from neurosym_jax.training.stream import SceneStream


def sums(scene):
    """A number that tells scenes apart: padding is zero."""
    return np.asarray(scene.displacement).sum(axis=(-3, -2, -1)).round(4)


def test_every_scene_once_an_epoch_of_its_class(windows):
    groups = SceneStream(windows, batch_scenes=6, seed=3).steps(0, 60)
    assert [group.valid.shape[1] for group in groups] == [3, 1, 1]  # By the share of sizes.
    classes = [group.valid.shape[2] for group in groups]
    for low, slots, group in zip([0, *classes], classes, groups):
        members = np.flatnonzero((windows.sizes > low) & (windows.sizes <= slots))
        identities = sums(group).reshape(-1)
        epochs = len(identities) // len(members)
        orders = identities[: epochs * len(members)].reshape(epochs, -1)
        drawn = np.sort(orders, axis=1)
        assert epochs > 1
        assert (drawn == drawn[0]).all()
        assert len(np.unique(drawn[0])) == len(members)
        assert len(members) < 3 or len(np.unique(orders, axis=0)) > 1


@pytest.mark.parametrize("max_agents", [None, 4])
def test_depends_on_seed_and_step_alone(windows, max_agents):
    def at(first, count, seed=1):
        return SceneStream(windows, 6, seed, max_agents).steps(first, count)

    whole = at(0, 12)
    parts = [at(0, 5), at(5, 1), at(6, 6)]
    for leaf, *pieces in zip(*map(jax.tree.leaves, [whole, *parts])):
        np.testing.assert_array_equal(leaf, np.concatenate(pieces))
    other = at(0, 12, seed=2)
    assert any(not np.array_equal(sums(a), sums(b)) for a, b in zip(whole, other))


def test_large_scenes_are_cropped_to_an_agent_and_its_nearest(make_windows):
    windows = make_windows([30], seed=4)
    obs_len = windows.obs_len
    last = windows.position[:, obs_len - 1]
    distance = np.linalg.norm(last[:, None] - last, axis=-1)
    neighbourhoods = {frozenset(np.argsort(row)[:6]) for row in distance}
    (group,) = SceneStream(windows, 1, seed=0, max_agents=6).steps(0, 200)
    assert group.valid.shape == (200, 1, 6)
    step = windows.position[:, 1:obs_len] - windows.position[:, : obs_len - 1]
    seen = set()
    for scene in jax.tree.map(lambda leaf: leaf[:, 0], group).displacement:
        moves = scene[:6, 1:]
        nearest = np.abs(moves[:, None] - step).max(axis=(2, 3))
        seen.add(frozenset(nearest.argmin(axis=1)))
    assert seen <= neighbourhoods
    assert len(seen) > len(neighbourhoods) / 2


def test_noise_has_the_kind_and_shape_asked_for(batch, run):
    groups = batch(20)
    per_agent = dataclasses.replace(run.network, noise_mix_type="ped", noise_type="uniform")
    for config in (run.network, per_agent):
        noises = draw_group_noise(config, groups, jax.random.key(0), 5)
        for noise, scene in zip(noises, groups):
            slots = scene.valid.shape if config is per_agent else scene.valid.shape[:1]
            assert noise.shape == (5, *slots, 2)
        flat = np.concatenate([np.ravel(noise) for noise in noises])
        assert len(np.unique(flat)) == len(flat)
        assert (np.abs(flat).max() > 1) == (config is run.network)
