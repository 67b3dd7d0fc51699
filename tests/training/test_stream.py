"""Batches: which scenes they have, how they are cropped and augmented, and their noise."""

import dataclasses

import jax
import numpy as np
import pytest

from neurosym_jax.models.sgan.training import GeneratorRecipe, draw_group_noise
from neurosym_jax.training.batches import SceneStream, augment


def sums(scene):
    """A number that tells scenes apart: padding is zero."""
    return np.asarray(scene.displacement).sum(axis=(-3, -2, -1)).round(4)


def test_every_scene_once_an_epoch_of_its_class(windows):
    groups = SceneStream(windows, batch_scenes=6, seed=3).steps(0, 60)
    assert [group.valid.shape[1] for group in groups] == [
        3,
        1,
        1,
    ]  # By the share of sizes.
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

    complete = at(0, 12)
    parts = [at(0, 5), at(5, 1), at(6, 6)]
    for leaf, *pieces in zip(*map(jax.tree.leaves, [complete, *parts])):
        np.testing.assert_array_equal(leaf, np.concatenate(pieces))
    other = at(0, 12, seed=2)
    assert any(not np.array_equal(sums(a), sums(b)) for a, b in zip(complete, other))


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
    per_agent = dataclasses.replace(
        run.config, noise_mix_type="ped", noise_type="uniform"
    )
    for config in (run.config, per_agent):
        noises = draw_group_noise(config, groups, jax.random.key(0), 5)
        for noise, scene in zip(noises, groups):
            slots = scene.valid.shape if config is per_agent else scene.valid.shape[:1]
            assert noise.shape == (5, *slots, 2)
        flat = np.concatenate([np.ravel(noise) for noise in noises])
        assert len(np.unique(flat)) == len(flat)
        assert (np.abs(flat).max() > 1) == (config is run.config)
        assert flat.min() < -0.9


def augmented(groups, **recipe):
    """(before, after) of each group, on the host."""
    recipe = GeneratorRecipe(**{"rotate": 0.0, **recipe})
    return list(
        zip(
            groups, jax.tree.map(np.asarray, augment(groups, jax.random.key(0), recipe))
        )
    )


@pytest.mark.slow
def test_scenes_are_turned_and_mirrored(batch):
    mirrored = []
    for before, after in augmented(batch(20), rotate=1.0):
        np.testing.assert_array_equal(before.valid, after.valid)
        assert np.abs(before.displacement - after.displacement).max() > 0.1
        # Distances stay, between agents too, and from what was observed to what
        # followed.
        track = [
            np.concatenate([s.observed, s.future], axis=2) for s in (before, after)
        ]
        flat = [t.reshape(len(t), -1, 2) for t in track]
        distances = [np.linalg.norm(f[:, :, None] - f[:, None], axis=-1) for f in flat]
        np.testing.assert_allclose(*distances, atol=1e-5)
        moves = np.diff(after.observed, axis=2, prepend=after.observed[:, :, :1])
        np.testing.assert_allclose(after.displacement, moves, atol=1e-5)
        cross = [f[:, :-1, 0] * f[:, 1:, 1] - f[:, :-1, 1] * f[:, 1:, 0] for f in flat]
        ratio = (cross[0] * cross[1]).sum(axis=1) / (cross[0] ** 2).sum(axis=1)
        np.testing.assert_allclose(np.abs(ratio), 1, atol=1e-4)
        mirrored += list(ratio < 0)
    assert 0 < sum(mirrored) < len(mirrored)


def test_a_share_of_the_scenes_is_turned_and_all_are_scaled(batch):
    groups = batch(20)
    assert augment(groups, jax.random.key(0), GeneratorRecipe(rotate=0.0)) is groups
    turned = augmented(groups, rotate=0.5)
    same = [
        (before.future == after.future).all(axis=(1, 2, 3)) for before, after in turned
    ]
    assert 0.25 < np.concatenate(same).mean() < 0.75
    for before, after in augmented(groups, scale=0.2):
        size = [(s.observed**2).sum(axis=(1, 2, 3)) for s in (before, after)]
        factor = np.sqrt(size[1] / size[0])[:, None, None, None]
        assert 0.8 < factor.min() < 0.95 < 1.05 < factor.max() < 1.2
        np.testing.assert_allclose(after.observed, factor * before.observed, atol=1e-5)


@pytest.mark.slow
def test_observed_positions_err_by_as_much_as_their_scene_does(batch):
    deviations = []
    for before, after in augmented(batch(20), jitter=0.1):
        for name in ("future", "valid"):
            np.testing.assert_array_equal(getattr(before, name), getattr(after, name))
        steps = np.diff(after.observed, axis=2, prepend=after.observed[:, :, :1])
        np.testing.assert_allclose(after.displacement, steps, atol=1e-6)
        error = after.observed - before.observed
        assert np.abs(error[before.valid].mean()) < 0.05
        deviations += list(error.std(axis=(1, 2, 3)))
    # Uniform in [0, jitter], so far from equal; each estimated from a few dozen draws.
    assert 0.03 < np.mean(deviations) < 0.07
    assert np.std(deviations) > 0.015
    assert max(deviations) < 0.13


@pytest.mark.slow
def test_a_share_of_the_scenes_is_one_persons(batch):
    groups, reduced = batch(20), []
    for before, after in augmented(groups, single_agent_share=0.5):
        np.testing.assert_array_equal(before.observed, after.observed)
        assert not (after.valid & ~before.valid).any()
        single = after.valid.sum(axis=1) == 1
        np.testing.assert_array_equal(after.valid[~single], before.valid[~single])
        reduced += [
            (alone, alone and first) for alone, first in zip(single, after.valid[:, 0])
        ]
    share, first = np.mean(reduced, axis=0)
    assert 0.25 < share < 0.75
    assert 0 < first < share  # It is not always the same person.
    empty = tuple(scene.replace(valid=np.zeros_like(scene.valid)) for scene in groups)
    for _, after in augmented(empty, single_agent_share=1.0):
        assert not after.valid.any()
