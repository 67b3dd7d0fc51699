"""Draws of scenes: how often each trajectory is drawn, who overlaps, and what padding changes."""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neurosym_jax.data.windows import Windows, make_batches
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.metrics import collisions
from neurosym_jax.evaluation.scores import DRAWS, score, score_forecaster
from neurosym_jax.models.anchors.config import AnchorConfig
from neurosym_jax.models.anchors.draws import (
    _companionship,
    _overlaps,
    _partings,
    couple,
    draw_samples,
    draw_scenes,
    equal_points,
    nearest,
    pair_terms,
)
from neurosym_jax.models.anchors.forecaster import apply_anchors
from neurosym_jax.models.disk import load_model
from neurosym_jax.models.forecast import predict, predict_distribution
from neurosym_jax.models.sgan.network import GeneratorConfig
from neurosym_jax.scene import make_scene, to_world
from tests.networks import random_model
from tests.repository import exhaustive

KEY = jax.random.key(3)
DRAW = jax.jit(draw_scenes, static_argnums=(3, 4))
PEOPLE = jnp.ones(5, bool)


@pytest.fixture(scope="module")
def points():
    """Five people who stand in a row, 0.3 m apart, and may move to either side by up to 1 m."""
    rng = np.random.default_rng(0)
    end = 0.3 * np.arange(5)[:, None] * [1, 0] + rng.uniform(-1, 1, (20, 5, 2))
    return jnp.asarray(end[:, :, None] * np.linspace(0.5, 1, 4)[:, None], jnp.float32)


def scene_of(start, step=(0.0, 0.0), **changes):
    """People at `start [N, 2]` now, who came by `step` ([N, 2] or [2], metres)."""
    past = np.arange(-7, 1)[:, None] * np.broadcast_to(step, np.shape(start))[:, None]
    scene = make_scene(np.zeros((len(start), 8, 2))).bare()
    return scene.replace(
        observed=jnp.asarray(np.asarray(start)[:, None] + past), **changes
    )


ROW = scene_of(
    0.3 * np.arange(5)[:, None] * [1, 0], [[0.4 * 2**i, 0] for i in range(5)]
)
"""Of `points`: people who pass each other and do not walk together."""


def names(draws, points):
    """[n, N] which point of its person each trajectory is."""
    distance = np.abs(np.asarray(draws)[:, None] - np.asarray(points)).max((-1, -2))
    assert distance.min(1).max() < 1e-6
    return distance.argmin(1)


@pytest.mark.slow
@pytest.mark.parametrize("count", [exhaustive(1), exhaustive(20), 60, 70])
def test_every_point_of_somebody_alone_is_drawn_equally_often(points, count):
    scene = scene_of([[9.0 * i, 0] for i in range(5)])
    distant = points + 9 * jnp.arange(5)[:, None, None] * jnp.array([1, 0])
    chosen = names(DRAW(distant, scene, KEY, count, 0.4), distant)
    for person in chosen.T:
        often = np.bincount(person, minlength=20)
        assert np.abs(often - count / 20).max() < (2 if count % 20 else 1e-6)


def test_people_are_drawn_independently_but_do_not_overlap(points):
    """Apart by 9 m the points of two people have nothing to do with each other."""
    distant = points[:, :2] + jnp.array([[0.0, 0.0], [9.0, 0.0]])[:, None]
    scene = scene_of([[0, 0], [9, 0]])
    pairs = np.zeros((20, 20))
    for seed in range(40):
        chosen = names(DRAW(distant, scene, jax.random.key(seed), 60, 0.4), distant)
        np.add.at(pairs, tuple(chosen.T), 1)
    assert pairs.sum() == 40 * 60
    # A pair is expected 6 times; of 400, the variance is that of a Poisson variable.
    assert 0.8 < pairs.var() / 6 < 1.25
    lots = np.random.default_rng(1).integers(0, 20, (200, 5))
    independent = np.take_along_axis(np.asarray(points), lots[..., None, None], axis=0)
    assert collisions(independent, PEOPLE).mean() > 0.2
    for count in (1, 60):  # One scene, too.
        keys = map(jax.random.key, range(180 // count))
        draws = np.concatenate([DRAW(points, ROW, key, count, 0.4) for key in keys])
        assert collisions(draws, PEOPLE).mean() < 0.03


def test_scenes_are_as_probable_as_the_pairs_say():
    """Three people with three points, against the probabilities of all 27 scenes."""
    rng = np.random.default_rng(2)
    cost = {
        (i, j): rng.uniform(0, 1.5, (3, 3)) for i in range(3) for j in range(i + 1, 3)
    }
    scenes = list(itertools.product(range(3), repeat=3))
    nats = [sum(table[s[i], s[j]] for (i, j), table in cost.items()) for s in scenes]
    expected = np.exp(-np.array(nats)) / np.exp(-np.array(nats)).sum()
    near = np.array([[1, 2], [2, 0], [0, 1]])
    both = cost | {(j, i): table.T for (i, j), table in cost.items()}
    table = [both[int(other), i] for i in range(3) for other in near[i]]
    table = jnp.asarray([*table, np.zeros((3, 3))], jnp.float32)
    rows = jnp.arange(6).reshape(3, 2)
    start = jnp.asarray(rng.integers(0, 3, (30000, 3)))
    chosen = jax.jit(couple)(start, jnp.asarray(near), table, rows, KEY)
    often = np.bincount(np.asarray(chosen) @ [9, 3, 1], minlength=27) / 30000
    np.testing.assert_allclose(often, expected, atol=0.006)
    assert np.abs(expected - 1 / 27).max() > 0.05


def test_pairs_that_are_left_out_say_nothing():
    """Thirty people of whom nine stand close by: some are near to one who has others nearer."""
    rng = np.random.default_rng(4)
    start = rng.uniform(0, 4, (30, 2))
    start[:9] = 2 + rng.uniform(-0.4, 0.4, (9, 2))
    speed = rng.normal(0, 0.6, (30, 2))
    speed[20:] = [1.0, 0.2]  # They walk together.
    time = 0.4 * np.arange(16)[:, None]
    ways = start[:, None] + speed[:, None] * time
    points = ways[:, 8:] + rng.normal(0, 0.2, (6, 30, 8, 2)).cumsum(axis=2)
    scene = make_scene(ways[:, :8])
    points = jnp.asarray(points - scene.origin, jnp.float32)
    valid = jnp.asarray(scene.valid).at[3].set(False)
    near, present = jax.jit(nearest)(points, valid)
    table, rows = jax.jit(pair_terms, static_argnums=4)(
        points, scene.bare(), near, present, 0.4
    )
    rows = np.asarray(rows)
    assert 0.2 < (rows < len(table) - 1).mean() < 0.8
    assert not np.asarray(table[-1]).any()
    others = np.asarray(near)
    is_mutual = (others[others] == np.arange(30)[:, None, None]).any(axis=2)
    assert 0.1 < is_mutual.mean() < 0.95

    first = jnp.repeat(jnp.arange(30), 16)
    second = near.ravel()
    last = jnp.asarray(ways[:, 7] - scene.origin, jnp.float32)
    moved = points - last[:, None]
    overlap = jax.jit(_overlaps)(points, first, second)
    parted = np.minimum(jax.jit(_partings)(moved, first, second), 1)
    together = np.where(present, _companionship(scene.bare().observed, near, 0.4), 0)
    total = np.maximum(together.sum(axis=1), 1)
    most = np.maximum(total[np.asarray(first)], total[np.asarray(second)])
    hold = together.ravel() / most
    expected = 8 * np.asarray(overlap) + 3 * hold[:, None, None] * parted
    expected = np.where(np.asarray(present).ravel()[:, None, None], expected, 0)
    np.testing.assert_allclose(np.asarray(table)[rows.ravel()], expected, atol=1e-5)


@pytest.mark.slow
def test_what_two_people_do_is_that_of_sums_over_loops(points):
    """The overlap of their nearest moment, between two steps, too; and how far they part."""
    first, second = jnp.array([0, 2, 4, 3, 1]), jnp.array([1, 1, 0, 2, 0])
    last = jnp.asarray(np.random.default_rng(3).normal(size=(5, 2)), jnp.float32)
    table = np.asarray(_overlaps(points, first, second))
    moved = points - last[:, None]
    partings = np.asarray(_partings(moved, first, second))
    places = np.asarray(points, np.float64)
    parts = np.linspace(0, 1, 201)[:, None, None]
    between = places[:, :, None, :-1] * (1 - parts) + places[:, :, None, 1:] * parts
    for pair, (a, b) in enumerate([(3, 7), (19, 0), (5, 5), (8, 2), (0, 1)]):
        i, other = int(first[pair]), int(second[pair])
        offset = between[b, i] - between[a, other]
        expected = max(0, 1 - np.linalg.norm(offset, axis=-1).min() / 0.3)
        assert table[pair, a, b] == pytest.approx(expected, abs=2e-4)
        change = places[b, i] - places[a, other] - np.asarray(last[i] - last[other])
        rms = np.sqrt(np.square(change).sum(-1).mean())
        assert partings[pair, a, b] == pytest.approx(rms, abs=1e-4)
    assert 0.02 < (table > 0).mean() < 0.9


@pytest.mark.parametrize(
    ("steps", "together"),
    [([[0.5, 0], [0.5, 0]], True), ([[0.5, 0], [-0.5, 0]], False)],
)
def test_two_who_walk_together_stay_together(steps, together):
    """They slow down or go on in the same scenes; two who pass each other do not."""
    start = np.array([[0.0, 0], [0, 0.8]])
    ahead = np.arange(1, 9)[:, None] * np.asarray(steps)[:, None]  # [N, T, 2]
    points = jnp.asarray(
        start[:, None] + np.linspace(0.4, 1.6, 20)[:, None, None, None] * ahead
    )
    draws = np.asarray(DRAW(points, scene_of(start, steps), KEY, 400, 0.4))
    pace = draws[:, :, -1, 0] / np.array(steps)[:, 0]
    assert np.corrcoef(pace.T)[0, 1] == pytest.approx(
        0.6 if together else 0.0, abs=0.25
    )


@pytest.mark.slow
def test_many_companions_hold_a_person_as_one_does():
    """In a stream of people the sum of their pulls would forbid everybody to turn."""
    spread = []
    for people in (2, 9):
        start = 0.31 * np.arange(people)[:, None] * [0, 1.0]
        ahead = np.arange(1, 9)[:, None] * np.array([0.5, 0])
        pace = np.linspace(0.4, 1.6, 20)[:, None, None, None]
        points = jnp.asarray(start[:, None] + pace * ahead[None])
        draws = DRAW(points, scene_of(start, [0.5, 0]), KEY, 400, 0.4)
        spread.append(np.std(draws[:, :, -1, 0]))
    assert spread[1] > 0.9 * spread[0], spread


def test_padding_changes_no_draw(points):
    padded = jnp.concatenate([points, jnp.full((20, 3, 4, 2), 0.1)], axis=1)
    observed = jnp.concatenate([ROW.observed, ROW.observed[:3]])
    scene = ROW.replace(observed=observed, valid=jnp.arange(8) < 5)
    draws = DRAW(padded, scene, KEY, 60, 0.4)
    np.testing.assert_array_equal(draws[:, :5], DRAW(points, ROW, KEY, 60, 0.4))


def test_samples_are_drawn_as_often_as_their_probabilities_say():
    samples = jnp.arange(3.0)[:, None, None, None] * jnp.ones((1, 2, 4, 2))
    probability = jnp.array([0.5, 0.125, 0.375])
    draw = jax.jit(draw_samples, static_argnums=3)
    for count, expected in ((8, [4, 1, 3]), (1, None)):
        drawn = np.asarray(draw(samples, probability, KEY, count))
        assert drawn.shape == (count, 2, 4, 2)
        if expected:
            np.testing.assert_array_equal(
                np.bincount(drawn[:, 0, 0, 0].astype(int)), expected
            )
    often = jax.jit(
        jax.vmap(lambda key: draw_samples(samples, probability, key, 1)[0, 0, 0, 0])
    )
    drawn = np.asarray(often(jax.random.split(KEY, 2000)))
    counts = np.bincount(drawn.astype(int)) / 2000
    np.testing.assert_allclose(counts, probability, atol=0.04)


@pytest.fixture(scope="module")
def model():
    return random_model(
        AnchorConfig(pred_len=4, samples=5, points=6, hidden=8), std=0.3
    )


@pytest.mark.slow
def test_the_distribution_is_in_the_callers_frame_and_of_the_seed(model):
    observed = np.array([500.0, -80.0]) + np.random.default_rng(0).normal(
        0, 0.3, (3, 8, 2)
    ).cumsum(1)
    draws = predict_distribution(model, observed, draws=7)
    assert draws.shape == (7, 3, 4, 2)
    assert draws.dtype == np.float64
    assert np.abs(draws - observed[:, -1:]).max() < 10
    np.testing.assert_array_equal(draws, predict_distribution(model, observed, draws=7))
    # All points of each person, though they do not appear equally often.
    seeds = range(100, 130)
    points = np.concatenate(
        [predict_distribution(model, observed, draws=24, seed=seed) for seed in seeds]
    )
    for changed in ({"seed": 1}, {"frame": 1}, {"recording": "other"}):
        other = predict_distribution(model, observed, draws=7, **changed)
        assert (other != draws).any()
        assert np.abs(other[:, None] - points).max((-1, -2)).min(1).max() < 1e-4
    with pytest.raises(InputError, match="draws"):
        predict_distribution(model, observed, draws=0)
    with pytest.raises(InputError, match=r"nj\.forecast"):
        jax.jit(functools.partial(predict_distribution, model))(observed)


@pytest.mark.slow
def test_the_distribution_of_a_mirrored_scene_is_the_mirrored_one(model):
    observed = np.random.default_rng(0).normal(0, 0.3, (3, 8, 2)).cumsum(1)
    # Everybody is alone and has all points.
    observed += 20 * np.arange(3)[:, None, None]
    mirror = np.array([1.0, -1.0])
    draws = predict_distribution(model, observed, draws=24)
    mirrored = predict_distribution(model, observed * mirror, draws=24) * mirror
    for axis in range(2):
        both = (np.sort(each[..., axis], axis=0) for each in (draws, mirrored))
        np.testing.assert_allclose(*both, atol=1e-4)
    # The network by itself is not symmetric: each half of the draws differs from the
    # other.
    scene = make_scene(observed)
    views = (scene, scene.replace(observed=scene.observed * mirror.astype(np.float32)))
    apply = jax.jit(apply_anchors, static_argnums=0)
    points = [apply(model.config, model.params, view).points for view in views]
    assert np.abs(points[0] - points[1] * mirror.astype(np.float32)).max() > 0.05


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::neurosym_jax.errors.InputWarning")
def test_one_bad_position_moves_nobody_elses_distribution():
    model = load_model("anchors_zara1_8")
    walks = np.arange(8.0)[:, None] * [0.5, 0] + np.array(
        [[[0, 0]], [[0, 1]], [[3, 2]]]
    )
    usual = predict_distribution(model, walks, draws=300)
    for size in (1.0, 15.0, 1000.0):
        for step in range(8):
            wrong = walks.copy()
            wrong[0, step] += size * np.array([0.6, 0.8])
            draws = predict_distribution(model, wrong, draws=300)
            assert (
                np.linalg.norm(draws[:, 0] - wrong[0, -1], axis=-1).max()
                < 8 * 1.6 + 0.3
            )
            for level in (0.1, 0.5, 0.9):
                quantiles = (
                    np.quantile(each[:, 1:], level, axis=0) for each in (draws, usual)
                )
                np.testing.assert_allclose(*quantiles, atol=0.5)


def test_models_without_a_trained_distribution_draw_their_samples():
    observed = np.random.default_rng(0).normal(0, 0.3, (3, 8, 2)).cumsum(1)
    generator = random_model(GeneratorConfig(pred_len=4))
    draws = predict_distribution(generator, observed, draws=7, seed=2)
    np.testing.assert_allclose(
        draws, predict(generator, observed, samples=7, seed=2), atol=1e-5
    )


def test_a_table_draws_an_index_for_each_person():
    """Each of the 20 about equally often, of one person independently of another."""
    observed = np.random.default_rng(0).normal(0, 0.3, (2, 8, 2)).cumsum(1)
    table = load_model("anchor_table_zara1_8")
    draws = predict_distribution(table, observed, draws=200)
    samples = predict(table, observed)
    chosen = np.abs(draws[:, None] - samples).max((3, 4)).argmin(1)  # [200, 2]
    for agent in range(2):
        often = np.bincount(chosen[:, agent], minlength=20)
        np.testing.assert_allclose(often, 10, atol=1)
    assert (chosen[:, 0] == chosen[:, 1]).mean() < 0.2


@pytest.mark.slow
def test_independent_draws_are_no_more_even_than_chance():
    observed = np.random.default_rng(0).normal(0, 0.3, (3, 8, 2)).cumsum(1)
    table = load_model("anchor_table_zara1_8")
    scene = make_scene(observed).bare()
    samples = predict(table, observed)
    draws = table.forecaster.independent_draws(
        table.params, scene, jax.random.key(0), 2000
    )
    offset = np.abs(to_world(draws, make_scene(observed))[:, None] - samples)
    often = np.bincount(offset[:, :, 0].max((2, 3)).argmin(1), minlength=20)
    # The variance of a multinomial count is 2000 / 20 * 19 / 20; even draws have none.
    assert 40 < often.var() < 220


def independent(model, observed, frame):
    """The draws that a score takes."""
    scene = make_scene(observed, frame=frame)
    forecaster = model.forecaster
    draws = forecaster.independent_draws(
        model.params, scene.bare(), jax.random.key(0), DRAWS
    )
    return to_world(draws, scene)


@pytest.mark.slow
def test_metrics_of_the_distribution_are_of_draws(model):
    rng = np.random.default_rng(1)
    paths = rng.normal(size=(7, 1, 2)) * 2 + np.cumsum(
        rng.normal(0.3, 0.1, (7, 12, 2)), axis=1
    )
    identity = np.array([[0, 0], [0, 1], [0, 2]], np.uint32)
    windows = Windows(paths, np.arange(7), np.array([0, 2, 4, 7]), identity, 8)
    # The two scenes of two people, which are padded to three.
    options = {
        "samples": 5,
        "seed": 0,
        "metrics": ("energy_score", "coverage_50", "joint_ade"),
    }
    scores = score_forecaster(
        model.forecaster, model.params, make_batches(windows), **options
    ).scores
    pairs = ((windows.rows(np.array([number])), number) for number in range(2))
    for rows, number in pairs:
        observed, future = np.split(paths[rows], [8], axis=1)
        draws = independent(model, observed, number)
        for name, own in score(
            draws, future, metrics=["energy_score", "coverage_50"]
        ).items():
            mean = scores[name].total[number] / scores[name].count[number]
            assert mean == pytest.approx(own.mean, rel=1e-3), name
        samples = predict(model, observed, samples=5)
        joint = score(samples, future, metrics=["joint_ade"])["joint_ade"]
        assert scores["joint_ade"].total[number] == pytest.approx(
            joint.total[0], rel=1e-4
        )


def test_equal_points_are_as_frequent_as_their_weight_says():
    points = jnp.arange(6.0)[:, None, None, None] * jnp.ones((6, 2, 3, 2))
    weight = jnp.array([[0.125] * 4 + [0.5, 0.0], [0.25] * 4 + [0.0, 0.0]])
    keys = jax.random.split(jax.random.key(0), 500)
    draw = jax.jit(jax.vmap(lambda key: equal_points(points, weight, key, 4)))
    chosen = np.asarray(draw(keys))[..., 0, 0].astype(int)
    # Four points of equal weight remain what they are.
    assert (chosen[:, :, 1] == np.arange(4)).all()
    counts = np.bincount(chosen[:, :, 0].ravel(), minlength=6) / chosen[:, :, 0].size
    np.testing.assert_allclose(counts, weight[0], atol=0.03)
    # Each takes an equal part: half of four, in every set of points.
    assert ((chosen[:, :, 0] == 4).sum(1) == 2).all()
