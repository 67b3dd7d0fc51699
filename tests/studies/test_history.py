"""Symbols over time: what a history says, that arms differ, that runs continue, the report."""

import itertools
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
import polars as pl
import pytest

import studies.history as study
from neurosym_jax.forecasting.forecaster import FORECASTERS
from neurosym_jax.models.anchors.frames import heading_of
from neurosym_jax.models.anchors.network import AnchorNetwork
from neurosym_jax.symbolic.qtc import observe
from tests.networks import random_params

VALID = jnp.ones(4, bool)


def test_the_history_of_two_people_who_pass_each_other():
    """One walks along x, the other towards them, 1 m to their left; both at 1 m/s."""
    steps = 0.4 * np.arange(8)
    own = np.stack([steps - 1.2, 0 * steps], -1)
    other = np.stack([1.4 - steps, 0 * steps + 1], -1)
    states = observe(
        own, other, quantisation_factor=0.05, side_quantisation_factor=0.05
    )
    before, beside, after = [-1, -1, 1, 1], [0, 0, 1, 1], [1, 1, 1, 1]
    chain = [before] * 3 + [beside] + [after] * 3
    np.testing.assert_array_equal(states, chain)

    def expect(
        last, *, lasted, share, previous=(0, 0, 0, 0), transition=(0, 0), passing, alpha
    ):
        features = study.symbol_history(states[:last], 0.4)
        size = np.abs(chain[last - 1])
        values = [size, lasted, share, previous, transition, passing, alpha]
        expected = np.concatenate([np.ravel(chain[:last]), *map(np.ravel, values)])
        np.testing.assert_allclose(features, expected, atol=1e-6)

    # Of `passing`: each symbol's previous value, then the one that a 0 passes on to.
    seconds = (1.2, 1.2, 1.2, 1.2, 1.2)
    expect(3, lasted=seconds, share=1, passing=[0] * 8, alpha=1)
    expect(
        4,
        lasted=(0.4, 0.4, 1.6, 1.6, 0.4),
        share=1 / 4,
        previous=before,
        transition=(2, 1),
        passing=[-1, -1, 0, 0, 1, 1, 0, 0],
        alpha=15 / 11,
    )
    expect(
        7,
        lasted=(1.2, 1.2, 2.8, 2.8, 1.2),
        share=3 / 7,
        previous=beside,
        transition=(2, 1),
        passing=[0] * 8,
        alpha=1,
    )
    jump = study.symbol_history(jnp.array([before, after]), 0.4)
    # Two symbols changed, by two transitions: the diagram has no edge. No symbol is 0
    # to pass on.
    np.testing.assert_array_equal(jump[-11:], [2, 2, -1, -1, 0, 0, 0, 0, 0, 0, 1])


def test_the_geometry_of_a_step():
    """One walks at 1 m/s along y; another stands 2 m ahead, 1 m to the right."""
    own, other = jnp.array([[0, 0], [0, 0.4]]), jnp.array([[1.0, 2.0], [1.0, 2.0]])
    features = study.geometry_history(own, other, jnp.array([0.0, 1.0]), 0.4, 10.0)
    metres, soon = np.hypot(1.6, 1), 1.6 / 1.05
    nearest = np.exp(-2 * np.hypot(1.6 - soon, 1) - soon)
    expected = [1.6 / metres, -1 / metres, -1, 0, metres / 10, soon, nearest]
    np.testing.assert_allclose(features, expected, atol=1e-5)


def people(seed=0):
    """Four walkers within a few metres."""
    rng = np.random.default_rng(seed)
    velocity = rng.normal(size=(4, 1, 2)) * 0.4
    observed = rng.normal(size=(4, 1, 2)) * 2 + velocity * np.arange(8)[:, None]
    return jnp.asarray(observed + rng.normal(size=observed.shape) * 0.05, jnp.float32)


def features_of(arm, observed, valid=VALID, near=None):
    velocity = observed[:, -1] - observed[:, -2]
    heading = heading_of(velocity, 0.05)
    return jax.jit(study.ARMS[arm].pair_features)(
        observed, velocity, heading, valid, near
    )[0]


def test_arms_see_what_they_are_named_for():
    features = {arm: features_of(arm, people()) for arm in study.ARMS}
    widths = {arm: values.shape[-1] for arm, values in features.items()}
    assert widths == {"now": 12, "symbols": 65, "geometry": 61, "both": 114}
    histories = [features[arm][..., 12:] for arm in ("symbols", "geometry")]
    histories = jnp.concatenate(histories, -1)
    np.testing.assert_array_equal(features["both"][..., 12:], histories)
    for values in features.values():
        np.testing.assert_array_equal(values[..., :12], features["now"])
    assert (jnp.ptp(histories, axis=(0, 1)) > 0).mean() > 0.9


def test_histories_move_and_turn_with_the_scene():
    turn = jnp.array([[0.6, 0.8], [-0.8, 0.6]])
    moved = people() @ turn + jnp.array([5.0, -3.0])
    np.testing.assert_allclose(
        features_of("both", moved), features_of("both", people()), atol=1e-4
    )


def test_neighbours_that_are_listed_have_the_same_history():
    near = jnp.array([[3, 1], [0, 2], [2, 3], [1, 0]])
    listed, complete = (
        features_of("both", people(), near=near),
        features_of("both", people()),
    )
    np.testing.assert_allclose(
        listed, complete[jnp.arange(4)[:, None], near], atol=1e-5
    )


@pytest.mark.parametrize("arm", ["symbols", "geometry"])
def test_who_is_absent_or_far_has_no_history(arm):
    padded = people().at[3].set(0.0)
    features = features_of(arm, padded.at[1].set(padded[0]), jnp.arange(4) < 3)
    assert jnp.isfinite(features).all()
    np.testing.assert_array_equal(features[3], 0)
    np.testing.assert_array_equal(features[:, 3], 0)
    assert (features[0, 2] != 0).any()

    network = AnchorNetwork(study.ARMS[arm])
    params = random_params(network, people(), VALID, std=0.2)
    apply = jax.jit(
        lambda observed: network.apply(params, observed, VALID).samples[:, 0]
    )

    def effect_of_the_past(metres):
        standing = people()[0, -1] + jnp.array([metres, 0.0]) + jnp.zeros((8, 1))
        way = jnp.array([0.0, 2.0]) * jnp.array([4, 3, 2, 1])[:, None] / 4
        tracks = (
            people().at[3].set(track) for track in (standing, standing.at[:4].add(way))
        )
        return jnp.abs(jnp.subtract(*map(apply, tracks))).max()

    assert effect_of_the_past(2.0) > 1e-3
    assert effect_of_the_past(10.1) == 0


def test_a_command_does_the_runs_that_its_table_lacks_seed_by_seed(
    tmp_path, monkeypatch
):
    done = []

    def train(network, recipe, training, seed):
        done.append((seed, training, network.past_symbols, network.past_geometry))
        if len(done) == 20:
            raise KeyboardInterrupt
        return jnp.zeros(())

    def score(network, params, test):
        number = len(study.ARMS) * study.PLACES.index(test) + network.past_symbols
        return dict.fromkeys((*study.METRICS, "crossing joint_ade"), (0.1 + number, 7))

    monkeypatch.setattr(study, "SEEDS", range(2))
    monkeypatch.setattr(study, "train", train)
    monkeypatch.setattr(study, "score", score)
    monkeypatch.setattr(study, "load", lambda place, data: (place, place))
    resumed, uninterrupted = tmp_path / "resumed.csv", tmp_path / "uninterrupted.csv"
    with mock.patch.dict(FORECASTERS):
        with pytest.raises(KeyboardInterrupt):
            study.run_all(tmp_path, resumed)
        assert len(pl.read_csv(resumed)) == 19 * len(study.METRICS)
        study.run_all(tmp_path, resumed)
        study.run_all(tmp_path, resumed)
        assert len(done) == 25
        study.run_all(tmp_path, uninterrupted)
    assert resumed.read_text() == uninterrupted.read_text()
    assert done[:4] == [
        (0, "corridors", *past) for past in [(0, 0), (1, 0), (0, 1), (1, 1)]
    ]
    assert [seed for seed, *_ in done[25:]] == [0] * 12 + [1] * 12
    assert done[19] == done[20]


CHANGES = {"mean": -10, "corridors": -15, "zara2": -10, "univ": -5}
"""Per cent by which the histories change errors."""


def made_up_rows(dead=0):
    """Eight seeds in which both histories are worth the same, by place, and together no more."""
    draw, lines = np.random.default_rng(0), []
    level = {"corridors": 0.3, "zara2": 0.4, "univ": 0.6}
    for place, arm, seed in itertools.product(study.PLACES, study.ARMS, range(8)):
        change = 0 if arm == "now" else CHANGES[place] / 100
        for metric in study.METRICS[:-1]:
            error = level[place] * (1 + change + draw.normal(0, 0.004))
            lines.append((place, arm, seed, metric, error))
        sees = 0.5 if (place, arm) == ("univ", "both") and seed < dead else 1.0
        lines.append((place, arm, seed, "neighbour_near", sees))
    return pl.DataFrame(lines, schema=study.HEAD, orient="row")


def cells_of(text):
    rows = [line.strip("| ").split(" | ") for line in text.splitlines() if "−" in line]
    return {tuple(row[:2]): row[2:] for row in rows}


def test_the_report_says_which_history_helps():
    text = study.report(made_up_rows())
    cells = cells_of(text)
    assert list(dict.fromkeys(place for place, _ in list(cells)[:8])) == list(CHANGES)
    for place, change in CHANGES.items():
        seeds, percent, p, verdict, *_ = cells[place, "symbols − now"]
        assert (seeds, p, verdict) == ("8", "< .001", "**helps**")
        assert float(percent.split()[0].replace("−", "-")) == pytest.approx(
            change, abs=0.6
        )
        verdicts = cells[place, "both − geometry"][3::3]
        assert verdicts == ["**within 2 %**"] * 2
    assert float(cells["interacting", "symbols − geometry"][0].split()[0][1:]) < 0.6
    assert text.endswith("Networks left out: none.")


def test_the_report_of_a_table_that_is_not_whole():
    rows = made_up_rows()
    partial = rows.filter((pl.col("seed") < 4) | (pl.col("set") == "corridors"))
    answers = list(cells_of(study.report(partial)).values())[:8]
    assert {seeds for seeds, *_ in answers} == {"4"}
    assert cells_of(study.report(rows.filter(pl.col("seed") < 2))) == {}


@pytest.mark.parametrize(("dead", "answered"), [(2, True), (3, False)])
def test_an_arm_answers_if_at_most_a_quarter_of_its_networks_ignore_neighbours(
    dead, answered
):
    text = study.report(made_up_rows(dead))
    cells = cells_of(text)
    for place in ("mean", "univ"):
        assert cells[place, "both − geometry"][0] == str(8 - dead)
        assert ("**not answered**" in cells[place, "both − geometry"]) != answered
    assert cells["corridors", "both − geometry"][0] == "8"
    assert "**not answered**" not in cells["corridors", "both − geometry"]
    assert text.endswith(f"Networks left out: {dead} of 8 of `both` on univ.")
