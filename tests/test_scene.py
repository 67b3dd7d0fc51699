import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from neurosym_jax.data.tracks import make_tracks
from neurosym_jax.data.windows import cut_windows, make_batches
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.scores import score
from neurosym_jax.scene import make_scene, pad_scene, scene_identity, to_world
from neurosym_jax.symbolic.forecast import symbolic_forecast

RNG = np.random.default_rng(0)
WORLD = np.round(RNG.normal(size=(3, 8, 2)).cumsum(axis=1), 4)
FUTURE = np.round(RNG.normal(size=(3, 12, 2)).cumsum(axis=1), 4)


def test_centred_on_the_last_observed_positions():
    scene = make_scene(WORLD, FUTURE, recording="walk", frame=7)
    low, high = WORLD[:, -1].min(axis=0), WORLD[:, -1].max(axis=0)
    assert_array_equal(scene.origin, (low + high) / 2)
    assert scene.origin.dtype == np.float64
    assert_allclose(scene.observed, WORLD - scene.origin, atol=1e-6)
    assert_allclose(to_world(scene.observed, scene), WORLD, atol=1e-6)
    assert_allclose(to_world(scene.future, scene), FUTURE, atol=1e-6)
    assert {scene.observed.dtype, scene.displacement.dtype, scene.future.dtype} == {
        np.dtype(np.float32)
    }
    assert scene.valid.tolist() == [True] * 3
    assert_array_equal(scene.identity, scene_identity("walk", 7))
    assert make_scene(WORLD).future is None


@pytest.mark.parametrize("offset", [[4e5, 5e6], [-3e3, 4e3], [1e7, -1e7]])
def test_the_same_numbers_anywhere_on_the_map(offset):
    at_origin, shifted = (
        make_scene(WORLD + shift, FUTURE + shift) for shift in (0.0, np.array(offset))
    )
    for name in ("observed", "displacement", "future"):
        assert_array_equal(getattr(at_origin, name), getattr(shifted, name))
    assert_allclose(shifted.origin - at_origin.origin, offset, atol=1e-8)
    standing = np.broadcast_to([[[0.1, 0.7]]], (1, 8, 2)) + offset
    assert not make_scene(standing).displacement.any()


@pytest.mark.parametrize("distance", [600.0, 1e6, 1e7])
@pytest.mark.parametrize("agents", [2, 4])
def test_who_is_far_takes_no_decimals_of_the_others(distance, agents):
    """Two agents, of whom either is far from the other: the first is the one in the middle."""
    far = WORLD[:1] + np.array([distance, -distance])
    observed = np.concatenate([WORLD[: agents - 1], far])
    scene = make_scene(observed)
    assert_allclose(to_world(scene.observed, scene)[:-1], observed[:-1], atol=1e-6)
    # In a batch of windows, between scenes without such an agent.
    tracks = []
    for recording, positions in enumerate([WORLD, observed, WORLD]):
        steps = np.arange(8) * 0.4
        stamps = np.tile(steps, len(positions))
        person = np.repeat(np.arange(len(positions)), 8)
        places = positions.reshape(-1, 2)
        tracks.append(make_tracks(f"walk {recording}", stamps, person, places))
    batches = make_batches(cut_windows(tracks, 4, 4))
    starts = [make_scene(positions[:, :4]) for positions in (WORLD, observed, WORLD)]
    for batch in batches:
        for row, number in enumerate(batch.index):
            if number >= 0:
                people = len(starts[number].valid)
                in_batch = batch.scene.observed[row, :people]
                assert_array_equal(in_batch, starts[number].observed)
                assert_array_equal(batch.scene.origin[row], starts[number].origin)


def test_padding():
    with jax.enable_x64(True):
        scene = make_scene(WORLD, FUTURE)
    assert (
        scene.observed.dtype
        == scene.displacement.dtype
        == scene.future.dtype
        == np.float64
    )
    padded = pad_scene(scene, 5)
    assert padded.valid.tolist() == [True] * 3 + [False] * 2
    for name in ("observed", "displacement", "future"):
        assert_array_equal(getattr(padded, name)[:3], getattr(scene, name))
        assert not getattr(padded, name)[3:].any()
    assert_array_equal(padded.identity, scene.identity)
    assert_array_equal(padded.origin, scene.origin)
    assert pad_scene(make_scene(WORLD), 4).future is None


def test_identity():
    named = [scene_identity("a", 0), scene_identity("a", 1), scene_identity("b", 0)]
    assert len({tuple(identity) for identity in named}) == 3
    # Known numbers, because published results depend on them.
    assert scene_identity("crowds_zara01", 5).tolist() == [1561871216, 5]
    assert scene_identity("", 0).dtype == np.uint32


@pytest.mark.parametrize(
    ("observed", "future", "message"),
    [
        (
            np.zeros((3, 2)),
            None,
            r"observed must be \[agents, steps, 2\], not \[3, 2\]",
        ),
        (np.zeros((0, 8, 2)), None, "at least one agent"),
        (np.zeros((3, 0, 2)), None, "at least one step"),
        (
            np.where(np.arange(48).reshape(3, 8, 2) == 20, np.nan, 0),
            None,
            "agent 1, step 2 is not",
        ),
        (
            np.zeros((3, 8, 2)),
            np.zeros((2, 8, 2)),
            "future has 2 agents but observed has 3",
        ),
        (np.zeros((1, 8, 2)), np.full((1, 8, 2), np.nan), "future: agent 0, step 0"),
        (
            np.full((1, 8, 2), 1e200),
            None,
            "agent 0, step 0 is not finite, or beyond 1e.09 m",
        ),
        (np.ma.masked_equal(np.zeros((1, 8, 2)), 0), None, "some values are masked"),
        ([[[1, 2]], [[1]]], None, "observed: not an array of numbers"),
        (np.zeros((1, 8, 2), complex), None, "observed: not an array of numbers"),
    ],
)
def test_refused(observed, future, message):
    with pytest.raises(InputError, match=message):
        make_scene(observed, future)


@pytest.mark.parametrize(
    "read",
    [
        lambda masked: make_scene(WORLD, extras={"group": masked[:, 0, 0]}),
        lambda masked: make_scene(list(masked)),
        lambda masked: make_tracks("walk", [0, 1, 2], [1, 1, 1], masked[:, 0]),
        lambda masked: score(FUTURE[None], masked),
        lambda masked: symbolic_forecast(FUTURE[None], masked),
    ],
)
def test_masked_arrays_are_refused(read):
    masked = np.ma.array(WORLD[:, : FUTURE.shape[1]], mask=False)
    masked[1] = np.ma.masked
    with pytest.raises(InputError, match="some values are masked"):
        read(masked)


def test_a_forecaster_sees_no_future_origin_or_extras():
    scene = make_scene(WORLD, FUTURE, extras={"group": [1, 1, 2]})
    assert pad_scene(scene, 4).extras["group"].tolist() == [1, 1, 2, 0]
    bare = scene.bare()
    assert (bare.future, bare.origin, bare.extras) == (None, None, {})
    assert_array_equal(bare.observed, scene.observed)
    with pytest.raises(InputError, match=r"group has \[2\], not one for 3 agents"):
        make_scene(WORLD, extras={"group": [1, 1]})


def test_made_inside_a_transformation():
    def total(observed):
        scene = make_scene(
            observed, FUTURE, recording="walk", extras={"group": [1, 1, 2]}
        )
        return (scene.displacement**2).sum() + scene.observed.sum(), scene

    walk = make_scene(WORLD, FUTURE, recording="walk", extras={"group": [1, 1, 2]})
    (_, traced), gradient = jax.jit(jax.value_and_grad(total, has_aux=True))(
        np.float32(WORLD)
    )
    for name in ("observed", "displacement", "future", "origin", "valid", "identity"):
        assert_allclose(
            getattr(traced, name), getattr(walk, name), atol=2e-6, err_msg=name
        )
    assert_array_equal(traced.extras["group"], [1, 1, 2])
    assert np.abs(gradient).min(axis=(0, 2)).all()
    batch = jax.vmap(lambda observed: make_scene(observed))(
        np.float32([WORLD, WORLD + 1])
    )
    assert_allclose(batch.observed[1], walk.observed, atol=2e-6)
