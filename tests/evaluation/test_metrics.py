"""Every metric by its formula, by hand or by what it must tell apart."""

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import gaussian_kde

from neurosym_jax.data.windows import Windows, make_batches
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation import metrics
from neurosym_jax.evaluation.metrics import (
    COLLISION_DISTANCE,
    METRICS,
    SYMBOLS,
    collision_rate,
    collisions,
    metric_names,
)
from neurosym_jax.evaluation.scores import score, score_forecaster
from neurosym_jax.models.sgan.network import GeneratorConfig
from neurosym_jax.scene import make_scene
from neurosym_jax.symbolic.events import EVENTS
from tests.networks import random_model
from tests.repository import slow


def offsets(errors):
    """Forecasts that are off by `errors [k, N, T]` metres, in turning directions."""
    errors = np.asarray(errors, float)
    angle = np.arange(errors.size).reshape(errors.shape)
    return errors[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def scene(k=20, agents=4, steps=6, seed=0):
    draw = np.random.default_rng(seed)
    return draw.normal(size=(k, agents, steps, 2)), draw.normal(size=(agents, steps, 2))


def mean(metric, forecast, truth):
    return score(forecast, truth, metrics=[metric])[metric].mean


def test_best_of_k_by_hand():
    """Two samples, two agents, two steps; each minimum lies in a sample of its own."""
    truth = np.array([[[0.0, 0.0], [1.0, 0.0]], [[5.0, 5.0], [5.0, 6.0]]])
    # Sample 0: ADE 1 and 2, FDE 2 and 3; sample 1: ADE 2 and 1.5, FDE 1 and 1.
    forecast = truth + offsets([[[0, 2], [1, 3]], [[3, 1], [2, 1]]])
    scores = score(forecast, truth)
    assert all(value.count.tolist() == [2] for value in scores.values())
    expected = {
        "joint_ade": [3.0],  # Sample 0: 1 + 2.
        "joint_fde": [2.0],  # Sample 1: 1 + 1.
        "marginal_ade": [1 + 1.5],
        "marginal_fde": [1 + 1],
        "horizon": [[0 + 1, 2 + 3]],  # Sample 0.
        "collision_rate": [0],
    }
    assert scores.keys() == expected.keys()
    for name, total in expected.items():
        assert_allclose(scores[name].total, total, atol=1e-6, err_msg=name)
    assert mean("joint_fde_same", forecast, truth) == pytest.approx((2 + 3) / 2)
    assert mean("marginal_fde_same", forecast, truth) == pytest.approx((2 + 1) / 2)
    far = offsets([[[0, 2.1], [9, 1.9], [0, 3]], [[0, 2.2], [0, 9], [5, 0.5]]])
    assert mean("miss_rate", far, np.zeros((3, 2, 2))) == pytest.approx(1 / 3)


def test_agents_that_are_not_valid_change_nothing():
    rng = np.random.default_rng(0)
    forecast, truth = rng.normal(size=(4, 6, 5, 2)), rng.normal(size=(6, 5, 2))
    valid = np.array([True, False, True, True, False, True])
    forecast[:, 1], truth[4] = np.nan, np.nan
    names = [
        n for n, metric in METRICS.items() if not metric.moves and n not in SYMBOLS
    ]
    alone = score(forecast[:, valid] + 5e6, truth[valid] + 5e6, metrics=names)
    for name, value in score(forecast, truth, valid, metrics=names).items():
        assert value.count == 4
        assert_allclose(value.total, alone[name].total, rtol=1e-5, err_msg=name)


def test_only_metrics_asked_for_are_computed():
    names = metric_names()
    assert {"joint_ade", "collision_rate"} < set(names) < set(METRICS)
    assert metric_names(["crps"], collisions=False) == (
        *metric_names(collisions=False),
        "crps",
    )
    assert set(METRICS) - set(metric_names(["all"])) == set(SYMBOLS)
    assert set(metric_names(["all", *SYMBOLS])) == set(METRICS)
    with pytest.raises(
        InputError, match="neighbour_share: needs forecasts without neighbours"
    ):
        mean("neighbour_share", *scene())


def test_symbols_by_hand():
    """Two people who approach, one beyond 8 m; forecasts as it happened, and standing still."""
    step = np.arange(5)[:, None] * np.array([1.0, 0])
    paths = np.stack([step - [4, 0], [4, 0] - step, 0 * step + 100])
    observed, future = paths[:, :2], paths[:, 2:]
    standing = np.repeat(observed[:, -1:], 3, axis=1)
    for right, wrong in ((3, 0), (0, 1), (2, 1)):
        forecast = np.stack([future] * right + [standing] * wrong)
        scores = score(forecast, future, observed=observed, metrics=SYMBOLS)
        assert scores["state_log"].count == 2  # Ordered pairs.
        expected = -np.log((right + 1 / 81) / (right + wrong + 1))
        assert scores["state_log"].mean == pytest.approx(expected, rel=1e-5)
        # Approaching and meeting happen, at the last step, and none of the other
        # events.
        pair_scores, others = (
            -np.log((n + 0.5) / (right + wrong + 1)) for n in (right, right + wrong)
        )
        expected = (2 * pair_scores + (len(EVENTS) - 2) * others) / len(EVENTS)
        assert scores["event_log"].mean == pytest.approx(expected, rel=1e-5)


SINGLE, TRUTH = scene(k=1, seed=1)
SAMPLES = scene(k=7)[0]
CLOSE = SINGLE + 30 + 1e-3 * SAMPLES


@pytest.mark.parametrize("forecast", [SAMPLES, SINGLE, SINGLE.repeat(5, axis=0), CLOSE])
def test_proper_scores_and_the_central_sample_by_their_formulas(forecast):
    k = len(forecast)
    pairs = max(k * (k - 1), 1)  # Ordered ones of different samples.
    distances = np.sqrt(np.square(forecast[:, None] - forecast).sum(axis=(2, 3, 4)))
    error = np.sqrt(np.square(forecast - TRUTH).sum(axis=(1, 2, 3)))
    expected = (error.mean() - distances.sum() / pairs / 2) / np.sqrt(4 * 6)
    assert_allclose(mean("energy_score", forecast, TRUTH), expected, rtol=1e-5)
    apart = np.abs(forecast[:, None] - forecast).mean((2, 3, 4)).sum() / pairs
    expected = np.abs(forecast - TRUTH).mean() - apart / 2
    assert_allclose(mean("crps", forecast, TRUTH), expected, rtol=1e-5)
    medoid = (
        np.linalg.norm(forecast[:, None] - forecast, axis=-1)
        .mean(axis=(1, 2, 3))
        .argmin()
    )
    error = np.linalg.norm(forecast[medoid] - TRUTH, axis=-1)
    assert_allclose(mean("central_ade", forecast, TRUTH), error.mean(), rtol=1e-5)
    assert_allclose(
        mean("central_fde", forecast, TRUTH), error[:, -1].mean(), rtol=1e-5
    )


@pytest.mark.parametrize("metric", ["energy_score", "crps"])
def test_proper_scores_do_not_depend_on_the_number_of_draws(metric):
    """One scene by 2, 5 and 50 independent draws, many times: the same within the noise."""
    rng = np.random.default_rng(0)
    truth = rng.normal(size=(3, 2, 2))
    means = {}
    for k, repeats in ((2, 1200), (5, 500), (50, 60)):
        values = [
            mean(metric, rng.normal(size=(k, 3, 2, 2)), truth) for _ in range(repeats)
        ]
        means[k] = np.mean(values), np.std(values) / np.sqrt(repeats)
    expected, noise = means[50]
    for k in (2, 5):
        value, error = means[k]
        assert abs(value - expected) < 3.5 * np.hypot(error, noise), (k, means)
        # By all k^2 pairs it would be too large by spread / (2 k).
        assert 3.5 * np.hypot(error, noise) < 0.5 / (2 * k)


def test_samples_with_probabilities_are_all_that_can_happen():
    """Of a fair coin's two sides: the exact score, which draws of it have on average."""
    sides = np.array([0.0, 1.0])[:, None, None, None] * np.ones(2)
    truth = np.zeros((1, 1, 2))
    half = np.full(2, 0.5)
    options = {"metrics": ["energy_score"], "probability": half}
    exact = score(sides, truth, **options)["energy_score"].mean
    length = np.sqrt(2)
    assert exact == pytest.approx(length / 2 - length / 4, rel=1e-6)
    rng = np.random.default_rng(1)
    drawn = sides[rng.integers(2, size=4000)][None].reshape(400, 10, 1, 1, 2)
    scores = [mean("energy_score", forecast, truth) for forecast in drawn]
    assert np.mean(scores) == pytest.approx(exact, abs=0.02)


@pytest.mark.parametrize("k", [2, 5, 20])
def test_a_calibrated_forecast_covers_what_it_should(k):
    forecast, truth = scene(k, agents=256, steps=12, seed=4)
    for level in (50, 90):
        share = mean(f"coverage_{level}", forecast, truth)
        assert share == pytest.approx(level / 100, abs=0.03)
        if k > 2:
            assert mean(f"coverage_{level}", 0.5 * forecast, truth) < share - 0.1
            assert mean(f"coverage_{level}", 3 * forecast, truth) > share + 0.05


def test_a_region_needs_two_samples_and_holds_its_share_of_equals():
    _, truth = scene()
    assert np.isnan(mean("coverage_90", truth[None], truth))
    standing = np.repeat(truth[None], 20, axis=0)
    assert mean("coverage_90", standing, truth) == pytest.approx(0.9)
    assert mean("coverage_90", standing + 0.01, truth) == 0


def straight(start, end, steps=2):
    return np.linspace(start, end, steps)


@pytest.mark.parametrize(
    ("first", "other", "expected"),
    [
        # Both cross the middle at the same time, far from it at every step.
        (straight((-1, 0), (1, 0)), straight((0, -1), (0, 1)), True),
        # They pass through each other.
        (straight((-3, 0), (3, 0)), straight((3, 0), (-3, 0)), True),
        # The same paths, a step apart in time.
        (straight((-1, 0), (1, 0)), straight((0, -5), (0, -3)), False),
        # Side by side, nearer and farther than the limit.
        (straight((0, 0), (5, 0)), straight((0, 0.19), (5, 0.19)), True),
        (straight((0, 0), (5, 0)), straight((0, 0.21), (5, 0.21)), False),
        # Only at the last step, and only at the first.
        (straight((0, 0), (5, 0), 3), straight((5, 3), (5, 0.1), 3), True),
        (straight((0, 0), (5, 0), 3), straight((0.1, 0), (5, 9), 3), True),
        # Both stand; a single step.
        (straight((0, 0), (0, 0)), straight((0, 0), (0, 0)), True),
        (straight((0, 0), (0, 0), 1), straight((0.1, 0), (0, 0), 1), True),
        # Their lines meet, but before the forecast begins.
        (straight((1, 0), (2, 0)), straight((0, 1), (0, 2)), False),
    ],
)
def test_collisions_between_steps(first, other, expected):
    """Slots of padding, all at one place, collide with no person."""
    forecast = np.stack([first, other, 0 * first, 0 * first])[None]
    hit = collisions(forecast, np.array([True, True, False, False]))
    assert hit.tolist() == [[expected, expected, False, False]]


def test_collisions_of_a_batch_are_those_of_its_scenes():
    valid = np.arange(4) < np.array([[2], [4], [3]])
    forecast = np.random.default_rng(0).uniform(0, 1.5, (2, 3, 4, 3, 2))
    batch = jax.tree.map(
        lambda *leaves: np.stack(leaves), *[make_scene(forecast[0, 0])] * 3
    )
    rates = collision_rate(forecast, batch.replace(valid=valid))
    alone = [collisions(forecast[:, at], valid[at]).mean(axis=0) for at in range(3)]
    assert_allclose(rates, alone)
    assert 0 < rates[valid].mean() < 1


def test_collisions_against_dense_sampling():
    rng = np.random.default_rng(2)
    forecast = rng.uniform(0, 3, (6, 5, 4, 2))
    time = np.linspace(0, 1, 400)[:, None]
    dense = np.concatenate(
        [
            forecast[:, :, [t]] * (1 - time) + forecast[:, :, [t + 1]] * time
            for t in range(3)
        ],
        axis=2,
    )
    distance = np.linalg.norm(dense[:, :, None] - dense[:, None], axis=-1).min(axis=-1)
    distance[:, range(5), range(5)] = np.inf
    clear = np.abs(distance - COLLISION_DISTANCE).min(axis=-1) > 0.01
    hit = np.asarray(collisions(forecast, np.ones(5, bool)))
    expected = (distance < COLLISION_DISTANCE).any(axis=-1)
    assert (hit == expected)[clear].all()
    assert 0.2 < expected.mean() < 0.95


@pytest.fixture(scope="module")
def crowd():
    """Twenty samples of forty people who walk 5 m in a hall of 12 m."""
    draw = np.random.default_rng(5)
    step = draw.normal(0, 0.4, (40, 1, 2)) + draw.normal(0, 0.1, (20, 40, 12, 2))
    return (draw.uniform(0, 12, (40, 1, 2)) + step.cumsum(axis=2)).astype(np.float32)


def collisions_of_all_pairs(forecast, valid):
    """[k, N]: whether an agent comes near another between steps, all pairs computed."""
    offset = (forecast[:, :, None] - forecast[:, None]).astype(float)
    begin, step = offset[..., :-1, :], np.diff(offset, axis=-2)
    length = np.maximum((step**2).sum(-1), 1e-12)
    share = np.clip(-(begin * step).sum(-1) / length, 0, 1)
    least = np.linalg.norm(begin + share[..., None] * step, axis=-1).min(axis=-1)
    others = valid & ~np.eye(len(valid), dtype=bool)
    return ((least < COLLISION_DISTANCE) & others).any(axis=2) & valid


def test_boxes_change_nothing(crowd):
    valid = np.arange(40) % 7 > 0
    hits = collisions(crowd, valid)
    assert 0.02 < hits.mean() < 0.6
    assert (collisions_of_all_pairs(crowd, valid) == hits).all()


def test_the_excess_is_what_forecasts_collide_more_than_the_truth(crowd):
    truth = crowd[3]
    names = ("collision_rate", "truth_collision_rate", "excess_collisions")
    rate, true, excess = (
        value.mean for value in score(crowd, truth, metrics=names).values()
    )
    assert rate == pytest.approx(collisions(crowd, np.ones(40, bool)).mean(), rel=1e-6)
    assert true == pytest.approx(
        collisions(truth[None], np.ones(40, bool)).mean(), rel=1e-6
    )
    assert excess == pytest.approx(rate - true)
    assert score(truth[None], truth, metrics=names)["excess_collisions"].mean == 0


OBS, PRED = 4, 3
NEIGHBOURS = ("neighbour_share", "neighbour_near", "neighbour_move")


def windows(sizes) -> Windows:
    """Random walks, each agent's start 1.5 m from the one before, the last agent far away."""
    rng = np.random.default_rng(0)
    position = np.cumsum(rng.normal(0.1, 0.02, (sum(sizes), OBS + PRED, 2)), axis=1)
    bounds = np.concatenate([[0], np.cumsum(sizes)])
    position[..., 0] += (
        1.5 * (np.arange(len(position)) - np.repeat(bounds[:-1], sizes))[:, None]
    )
    position[bounds[1:] - 1] += 50
    identity = np.stack([np.zeros(len(sizes)), np.arange(len(sizes))], axis=1).astype(
        np.uint32
    )
    return Windows(position, np.arange(len(position)), bounds, identity, OBS)


WINDOWS = windows([3, 4, 1, 5, 4, 3])
BATCHES = make_batches(WINDOWS)


def effect(bias: float, **changes):
    model = random_model(GeneratorConfig(obs_len=OBS, pred_len=PRED, **changes))
    layer = model.params["params"]["pooling"]["mlp"]["layer_1"]
    layer["bias"] = layer["bias"] + bias
    options = {"samples": 3, "seed": 0, "metrics": NEIGHBOURS}
    scores = score_forecaster(model.forecaster, model.params, BATCHES, **options)
    assert (
        scores.scores["neighbour_share"].count.sum() == 19
    )  # Without the scene of one.
    assert (
        scores.scores["neighbour_near"].count.sum() == 14
    )  # Without the last of each scene.
    return [scores.mean(name) for name in NEIGHBOURS]


@pytest.mark.parametrize(
    "changes", [{"pooling": "as_described"}, slow({"noise_mix_type": "ped"})]
)
def test_a_living_pooling_moves_people_and_a_dead_one_does_not(changes):
    share, near, move = effect(10.0, **changes)
    assert min(share, near) > 0.8
    assert move > 0.01
    share, near, move = effect(-1e4, **changes)
    assert share == near == 0
    assert move < 1e-5


def test_moves_by_hand():
    moves = np.zeros((2, 3, 2, 2))
    moves[0, 0], moves[0, 1, 0], moves[:, 2] = [[0, 0.3], [3, 4]], [2e-3, 0], 9
    for gap, near in ((1.9, True), (2.1, False)):
        seen = np.array([[0.0, 0], [gap, 0], [0, 0]])[:, None]
        case = make_scene(np.repeat(seen, 2, axis=1)).replace(valid=np.arange(3) < 2)
        assert metrics.neighbour_near(moves, case)[1].tolist() == [near, near, False]
    move, company = metrics.neighbour_move(moves, case)
    assert_allclose(move[:2], [2.5, 0])
    share, same = metrics.neighbour_share(moves, case)
    assert share.all()
    assert company.tolist() == same.tolist() == [True, True, False]


@pytest.mark.parametrize("weighted", [False, True])
def test_a_kernel_density_is_scipys(weighted):
    draws, truth = scene(k=30, agents=3, steps=4)
    weights = np.random.default_rng(1).dirichlet(np.ones(30)) if weighted else None
    logs = []
    for person, step in np.ndindex(3, 4):
        density = gaussian_kde(draws[:, person, step].T, weights=weights)
        logs.append(density.logpdf(truth[person, step])[0])
    expected = -np.maximum(logs, -20).mean()
    scores = score(draws, truth, metrics=["kde_nll"], probability=weights)
    assert scores["kde_nll"].mean == pytest.approx(expected, abs=1e-4)


def test_a_kernel_density_of_nothing_is_bounded_and_of_one_draw_not_there():
    draws, truth = scene(k=30, agents=2, steps=3)
    assert mean("kde_nll", draws + 100.0, truth) == 20
    assert mean("kde_nll", np.repeat(draws[:1], 30, axis=0), truth) == 20
    on_a_line = draws[..., :1] * [1.0, 0.5]
    assert mean("kde_nll", on_a_line, truth) == 20
    # People who hardly move have a density, too: a narrow one.
    narrow = truth + 1e-3 * draws
    assert mean("kde_nll", narrow, truth) < -8
    scores = score(draws[:1], truth, metrics=["kde_nll"])
    assert scores["kde_nll"].count.tolist() == [0]
