import jax
import numpy as np
import pytest

from neurosym_jax.training.augmentation import augment
from neurosym_jax.training.recipe import TrainConfig


@pytest.fixture
def groups(batch):
    return batch(20)


def augmented(groups, **recipe):
    return augment(groups, jax.random.key(0), TrainConfig(**{"rotate": 0.0, **recipe}))


def test_scenes_are_turned_and_mirrored(groups):
    mirrored = []
    for before, after in zip(groups, augmented(groups, rotate=1.0)):
        np.testing.assert_array_equal(before.valid, after.valid)
        assert np.abs(before.displacement - after.displacement).max() > 0.1
        # Distances stay, between agents too, and from what was observed to what followed.
        track = [np.concatenate([s.observed, s.future], axis=2) for s in (before, after)]
        flat = [t.reshape(len(t), -1, 2) for t in track]
        apart = [np.linalg.norm(f[:, :, None] - f[:, None], axis=-1) for f in flat]
        np.testing.assert_allclose(*apart, atol=1e-5)
        moves = np.diff(after.observed, axis=2, prepend=after.observed[:, :, :1])
        np.testing.assert_allclose(after.displacement, moves, atol=1e-5)
        cross = [f[:, :-1, 0] * f[:, 1:, 1] - f[:, :-1, 1] * f[:, 1:, 0] for f in flat]
        ratio = (cross[0] * cross[1]).sum(axis=1) / (cross[0] ** 2).sum(axis=1)
        np.testing.assert_allclose(np.abs(ratio), 1, atol=1e-4)
        mirrored += list(ratio < 0)
    assert 0 < sum(mirrored) < len(mirrored)


def test_a_share_of_the_scenes_is_turned(groups):
    turned = augmented(groups, rotate=0.5)
    same = [(a.future == b.future).all(axis=(1, 2, 3)) for a, b in zip(groups, turned)]
    assert 0.25 < np.concatenate(same).mean() < 0.75
    assert augmented(groups) is groups


def test_scenes_are_scaled(groups):
    for before, after in zip(groups, augmented(groups, scale=0.2)):
        size = [(np.asarray(s.observed) ** 2).sum(axis=(1, 2, 3)) for s in (before, after)]
        factor = np.sqrt(size[1] / size[0])
        assert ((factor > 0.8) & (factor < 1.2)).all()
        np.testing.assert_allclose(
            after.observed, factor[:, None, None, None] * before.observed, atol=1e-5
        )


def test_observed_positions_err_by_as_much_as_their_scene_does(groups):
    deviations = []
    for before, after in zip(groups, augmented(groups, jitter=0.1)):
        np.testing.assert_array_equal(before.future, after.future)
        np.testing.assert_array_equal(before.valid, after.valid)
        observed = np.asarray(after.observed)
        steps = np.diff(observed, axis=2, prepend=observed[:, :, :1])
        np.testing.assert_allclose(after.displacement, steps, atol=1e-6)
        error = (observed - before.observed)[np.asarray(before.valid)]
        assert np.abs(error.mean()) < 0.05
        deviations += list((observed - before.observed).std(axis=(1, 2, 3)))
    # Uniform in [0, jitter], so far from equal; each estimated from a few dozen draws.
    assert 0.03 < np.mean(deviations) < 0.07
    assert np.std(deviations) > 0.015
    assert max(deviations) < 0.13


def test_a_share_of_the_scenes_is_one_persons(groups):
    kept, first = [], []
    for before, after in zip(groups, augmented(groups, single_agent_share=0.5)):
        np.testing.assert_array_equal(before.observed, after.observed)
        left = np.asarray(after.valid)
        assert not (left & ~np.asarray(before.valid)).any()
        one = left.sum(axis=1) == 1
        np.testing.assert_array_equal(left[~one], before.valid[~one])
        kept += list(one)
        first += list(left[one, 0])
    assert 0.25 < np.mean(kept) < 0.75
    assert 0 < np.mean(first) < 1  # It is not always the same person.
    empty = tuple(scene.replace(valid=np.zeros_like(scene.valid)) for scene in groups)
    for scene in augmented(empty, single_agent_share=1.0):
        assert not np.asarray(scene.valid).any()
