"""The study of weightings: its control, its groups of people, and what its tests say."""

import importlib
import itertools
from typing import Any
from unittest import mock

import jax
import numpy as np
import polars as pl
import pytest

from neurosym_jax.scene import make_scene, pad_scene
from neurosym_jax.symbolic.weighting import WEIGHTINGS, make_weighting
from studies.weighting.comparison import Runs, adjusted, answer
from studies.weighting.control import LENGTHS, PEOPLE, control
from studies.weighting.page import places
from studies.weighting.scores import groups_of, interacting

METRICS = ("joint_ade", "energy_score")


@pytest.fixture(scope="module", autouse=True)
def _weightings_of_the_study():
    """Registered for these tests alone."""
    with mock.patch.dict(WEIGHTINGS):
        # Again, where it was imported before: these tests need not follow one another.
        importlib.import_module("studies.weighting.arms").register()
        yield


def missed(strength):
    """Metres by which people miss a straight path: with another on their path, and without."""
    windows = control(20, 0, strength)
    path = windows.position.reshape(20, PEOPLE, sum(LENGTHS), 2)
    right = make_weighting("on_ones_path")
    acts = np.stack([right(scene[:, : LENGTHS[0]])[..., -1] for scene in path])
    obstructed = (acts * ~np.eye(PEOPLE, dtype=bool)).any(axis=2)
    step = path[:, :, LENGTHS[0] - 1] - path[:, :, LENGTHS[0] - 2]
    straight = path[:, :, LENGTHS[0] - 1] + step * LENGTHS[1]
    metres = np.linalg.norm(path[:, :, -1] - straight, axis=-1)
    assert 0.2 < obstructed.mean() < 0.95
    return np.median(metres[obstructed]), np.median(metres[~obstructed])


@pytest.mark.exhaustive
def test_in_the_control_people_give_way_to_weighed_people_only():
    near, others = missed(1.0)
    weakly, still_others = missed(0.2)
    assert near > 5 * others
    assert others == still_others
    assert near / 10 < weakly < near / 2


def test_people_interact_with_a_near_neighbour_that_comes_nearer():
    #          0 and 1 near each other, 2 goes away from 1, 3 is far, 4 is padding
    before = np.array([[0, 0], [1.5, 0], [2.5, 0], [9, 9], [0.5, 0]])
    last = np.array([[0.1, 0], [1.5, 0], [2.6, 0], [9, 9], [0.5, 0]])
    observed = np.stack([before, last], axis=1)
    valid = np.array([True, True, True, True, False])
    assert interacting(observed, valid).tolist() == [True, True, False, False, False]


def test_events_are_those_of_the_future():
    #                0 walks behind 1; 2 and 3 come towards each other and pass
    start = np.array([[0, 0], [1.5, 0], [6, 20], [3, 20.8]])
    pace = np.array([[0.4, 0], [0.4, 0], [-0.4, 0], [0.4, 0]])
    path = start[:, None] + pace[:, None] * np.arange(20)[:, None]

    def groups(observed):
        scene = pad_scene(make_scene(path[:, :observed], path[:, observed:]), 6)
        members = groups_of(jax.tree.map(lambda leaf: leaf[None], scene))
        return {name: valid[0].tolist() for name, valid in members.items()}

    none = [False] * 6
    assert groups(2)["passing"] == [False, False, True, True, False, False]
    # People that passed each other before the future begins do not pass in it.
    late = groups(8)
    assert late["following"] == [True, True, False, False, False, False]
    assert late["passing"] == late["overtaking"] == late["crossing"] == none


@pytest.mark.parametrize(
    ("mean", "spread", "says"),
    [
        (0.45, 0.005, "helps"),
        (0.55, 0.005, "harms"),
        (0.5, 0.003, "no effect beyond 2 %"),
        (0.5, 0.03, "open"),
    ],
)
def test_answers(tmp_path, mean, spread, says):
    runs = runs_with(tmp_path, mean, spread, dead=1)
    comparison = runs.compare("zara2", "new", "old")
    assert runs.dead.rows() == [("zara2", "new", 1, 12)]
    assert comparison.seeds == 11
    assert comparison.percent == pytest.approx(100 * (mean / 0.5 - 1), abs=300 * spread)
    assert answer(adjusted([comparison])[0]) == says
    assert runs.compare("zara2", "new", "absent") is None


def test_an_arm_with_too_many_dead_networks_answers_nothing(tmp_path):
    runs = runs_with(tmp_path, 0.45, 0.005, dead=2)
    assert runs.dead.rows() == [("zara2", "new", 2, 12)]
    comparison = runs.compare("zara2", "new", "old")
    assert comparison.seeds == 10
    assert answer(adjusted([comparison])[0]) == "not answered"


def test_the_unit_of_six_places_is_the_place():
    """Gains grow by half a per cent from place to place; hotel has two runs of an arm only."""
    names = ("eth", "hotel", "univ", "zara1", "corridors", "zara2")
    rows: list[tuple[Any, ...]] = [
        (name, "papers", 0, "neighbour_near", 1, 90) for name in names
    ]
    for (place, name), seed in itertools.product(enumerate(names), range(2, 8)):
        arms = {
            "papers": 1.04 + place / 200,
            "papers, quantised": 1 + 0.001 * (-1) ** seed,
            "papers, shuffled": 1 + 0.001 * (-1) ** place,
        }
        for arm, people, metric in itertools.product(
            arms, ("interacting", "all"), METRICS
        ):
            # Only the first four seeds count.
            error = arms[arm] if seed < 6 else 9.0
            count = 7 if name == "eth" else 90
            if name != "hotel" or seed > 3:
                rows.append((name, arm, seed - 2, f"{people} {metric}", error, count))
    columns = ["set", "arm", "seed", "metric", "value", "counted"]
    frame = pl.DataFrame(rows, columns, orient="row", strict=False)
    head, _, *lines = (
        line.replace("| |", "|").strip("| ").split(" | ")
        for line in places(frame).splitlines()
    )
    assert head[2:4] == [
        "quantised − papers, joint ADE, %",
        "quantised − papers, energy score, %",
    ]
    table = {name: cells for name, *cells in lines}
    assert [*table] == [
        *(
            "eth",
            "univ",
            "zara1",
            "corridors",
            "zara2",
            "mean",
            "50 people or more",
            "all people",
        )
    ]
    assert table["eth"][:2] == ["7", "−3.8 ± 0.2"]
    percents = [-4 / 1.04, -5 / 1.05, -5.5 / 1.055, -6 / 1.06, -6.5 / 1.065]
    half = 2.7764 * np.std(percents, ddof=1) / np.sqrt(5)
    assert table["mean"][0] == f"−{-np.mean(percents):.1f} ± {half:.1f} **helps**"
    assert table["mean"][2].endswith("**no effect beyond 2 %**")
    assert table["50 people or more"][0].startswith(f"−{-np.mean(percents[1:]):.1f}")


def runs_with(tmp_path, mean, spread, dead):
    """Twelve runs of two arms with these errors; networks of the first arm's first are `dead`."""
    draw, rows = np.random.default_rng(0), ["set,arm,seed,metric,value,counted"]
    for arm, middle in (("new", mean), ("old", 0.5)):
        for seed in range(12):
            error = middle + draw.normal(0, spread)
            rows.append(f"zara2,{arm},{seed},interacting joint_ade,{error},10")
            alive = 0.5 if arm == "new" and seed < dead else 0.99
            rows.append(f"zara2,{arm},{seed},neighbour_near,{alive},10")
    (tmp_path / "runs.csv").write_text("\n".join(rows))
    return Runs(pl.read_csv(tmp_path / "runs.csv"))
