"""Does a spread that follows the input help at a place that was left out? `docs/widening.csv`.

python -m studies.widening DATA THOR CITR MORE > docs/widening.csv

The points of `recommended` are stretched about their mean, by one factor for all people
or by exp(a + b · features of what was observed of a person). Factors are fitted at
eleven places and tried at the twelfth; places of one site are left out together. What is
fitted is the mean over places of the energy score, relative to that without stretching.
The folders are those of `studies.distribution`. Nothing is drawn at random.
"""

import csv
import sys
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import minimize

import neurosym_jax as nj
from neurosym_jax.data.recordings import recordings_in
from neurosym_jax.data.tables import ReadOptions
from neurosym_jax.data.windows import Batch, cut_windows, make_batches, on_grid
from neurosym_jax.errors import InputWarning
from neurosym_jax.scene import Scene

STEPS = 12
FACTORS = np.array([0.6, 0.7, 0.8, 0.9, 1, 1.1, 1.2, 1.3, 1.4, 1.5, 1.7, 2, 2.5])
"""Those at which scores are computed; between them they are interpolated."""
FEATURES = ("acceleration", "speed", "people within 3 m", "spread of the points")
PENALTY = 0.003
"""Of the squares of b, for features of standard deviation 1."""
ETH_UCY = {
    "eth": ("biwi_eth",),
    "hotel": ("biwi_hotel",),
    "univ": ("students001", "students003"),
    "zara1": ("crowds_zara01",),
    "zara2": ("crowds_zara02",),
}
SITES = {"zara1": "Zara", "zara2": "Zara", "Stanford": "Stanford"}
SITES |= {"kept back": "Stanford", "THÖR 1": "THÖR", "THÖR 3": "THÖR", "MAGNI": "THÖR"}
"""Of places that share one."""


class Test(NamedTuple):
    """What a model is tested on at a place."""

    place: str
    model: str
    files: Sequence[Path]
    options: ReadOptions = ReadOptions()
    skip: int = 3


class People(NamedTuple):
    """M people of a place: `energy [M, factors]` metres, `features [M, F]`."""

    energy: np.ndarray
    features: np.ndarray


def tests_of(data: Path, thor: Path, citr: Path, more: Path) -> Iterator[Test]:
    """Twelve places; of the crowds fewer windows."""
    for place, names in ETH_UCY.items():
        files = [data / "all" / f"{name}.txt" for name in names]
        skip = 20 if place == "univ" else 3
        yield Test(place, f"anchors_{place}_{STEPS}", files, skip=skip)
    general = f"anchors_general_{STEPS}"
    yield Test("THÖR 1", general, sorted(thor.glob("*thor1*.csv")))
    yield Test("THÖR 3", general, sorted(thor.glob("*thor3*.csv")))
    yield Test("MAGNI", general, sorted(thor.glob("*MAGNI*.csv")))
    yield Test("Stanford", general, sorted((more / "tests").glob("[!b]*.txt")))
    yield Test("kept back", general, sorted((more / "kept_back").glob("*.txt")))
    options = ReadOptions(fps=29.97)
    yield Test("CITR", general, sorted(citr.glob("*.csv")), options)
    yield Test("corridors", general, sorted((more / "tests").glob("bo*.txt")))


def people_of(test: Test) -> People:
    """Scores at all factors, and features, of the people of a place."""
    model = nj.load_model(test.model)
    recordings = recordings_in(list(test.files), test.options)
    tracks = [on_grid(recording) for recording in recordings]
    windows = cut_windows(tracks, model.config.obs_len, STEPS, skip=test.skip)

    @jax.jit
    @jax.vmap
    def scored(scene: Scene, future: jax.Array) -> tuple[jax.Array, jax.Array]:
        key = jax.random.key(0)  # Points are not drawn.
        return energies(model.forecaster.points(model.params, scene, key), future)

    energy, features = [], []
    for batch in make_batches(windows):
        scores, spread = scored(batch.scene.bare(), batch.scene.known_future)
        counted = np.asarray(batch.scene.valid) & (batch.index >= 0)[:, None]
        energy.append(np.asarray(scores)[counted])
        features.append(features_of(batch, np.asarray(spread))[counted])
    return People(np.concatenate(energy), np.concatenate(features))


def energies(points: jax.Array, future: jax.Array) -> tuple[jax.Array, jax.Array]:
    """[N, factors] energy scores of stretched `points [P, N, T, 2]`, [N] their mean distance."""
    centre = points.mean(axis=0)
    offset = points - centre
    product = jnp.einsum("intc,jntc->nij", offset, offset)
    square = jnp.square(offset).sum(axis=(2, 3)).T
    apart = square[:, :, None] + square[:, None] - 2 * product
    distance = jnp.sqrt(jnp.maximum(apart, 0)).mean(axis=(1, 2))

    def at(factor: jax.Array) -> jax.Array:
        error = jnp.square(centre - future + factor * offset).sum(axis=(2, 3))
        return jnp.sqrt(error).mean(axis=0) - factor * distance / 2

    scale = jnp.sqrt(points.shape[2])
    return jax.vmap(at)(jnp.asarray(FACTORS)).T / scale, distance / scale


def features_of(batch: Batch, spread: np.ndarray) -> np.ndarray:
    """[B, N, F] `FEATURES`, by their logarithms, of a batch and its spreads [B, N]."""
    observed = np.asarray(batch.scene.observed)
    valid = np.asarray(batch.scene.valid)
    period = 0.4
    step = np.diff(observed, axis=2) / period
    speed = np.linalg.norm(step, axis=-1).mean(axis=-1)
    change = np.diff(step, axis=2) / period
    acceleration = np.linalg.norm(change, axis=-1).mean(axis=-1)
    last = observed[:, :, -1]
    distance = np.linalg.norm(last[:, :, None] - last[:, None], axis=-1)
    others = valid[:, None] & ~np.eye(valid.shape[1], dtype=bool)
    people = (others & (distance < 3)).sum(axis=-1)
    columns = np.log(acceleration + 0.1), np.log(speed + 0.2), np.log1p(people)
    return np.stack([*columns, np.log(spread + 0.1)], axis=-1)


def stretched(people: People, coefficients: np.ndarray) -> float:
    """Mean energy, relative to that without stretching, with a and b of `coefficients [1 + F]`."""
    inputs = people.features[:, : len(coefficients) - 1]
    factor = np.exp(coefficients[0] + inputs @ coefficients[1:])
    factor = np.clip(factor, FACTORS[0], FACTORS[-1])
    below = np.clip(np.searchsorted(FACTORS, factor) - 1, 0, len(FACTORS) - 2)
    part = (factor - FACTORS[below]) / (FACTORS[below + 1] - FACTORS[below])
    person = np.arange(len(factor))
    low, high = people.energy[person, below], people.energy[person, below + 1]
    unstretched = people.energy[:, FACTORS == 1].mean()
    return float(((1 - part) * low + part * high).mean() / unstretched)


def fitted(places: Sequence[People], features: int) -> np.ndarray:
    """[1 + features] coefficients with the least mean over `places`."""

    def cost(coefficients: np.ndarray) -> float:
        mean = np.mean([stretched(place, coefficients) for place in places])
        return float(mean + PENALTY * np.square(coefficients[1:]).sum())

    options = {"maxiter": 20}
    start = np.zeros(1 + features)
    return np.atleast_1d(minimize(cost, start, method="Powell", options=options).x)


def standardised(places: dict[str, People]) -> dict[str, People]:
    """Features of mean 0 and standard deviation 1 over all places, each counted equally."""
    means = [people.features.mean(axis=0) for people in places.values()]
    mean = np.mean(means, axis=0)
    squares = [((p.features - mean) ** 2).mean(axis=0) for p in places.values()]
    deviation = np.sqrt(np.mean(squares, axis=0))
    return {
        place: people._replace(features=(people.features - mean) / deviation)
        for place, people in places.items()
    }


def write(tests: Sequence[Test]) -> None:
    """Print the table."""
    places = standardised({test.place: people_of(test) for test in tests})
    rows = csv.writer(sys.stdout, lineterminator="\n")
    changes = ("best factor", "one factor", "by acceleration and speed", "by all four")
    rows.writerow(["place", "people", "best factor", *(f"{c}, %" for c in changes)])
    totals = []
    for place, people in places.items():
        site = SITES.get(place, place)
        others = [p for name, p in places.items() if SITES.get(name, name) != site]
        means = people.energy.mean(axis=0)
        best = means.min() / means[FACTORS == 1].item()
        tried = [stretched(people, fitted(others, count)) for count in (0, 2, 4)]
        change = 100 * (np.array([best, *tried]) - 1)
        totals.append(change)
        factor = FACTORS[means.argmin()]
        cells = [f"{number:+.1f}" for number in change]
        rows.writerow([place, len(people.energy), factor, *cells])
    cells = [f"{number:+.1f}" for number in np.mean(totals, axis=0)]
    rows.writerow(["mean", "", "", *cells])


if __name__ == "__main__":
    warnings.simplefilter("ignore", InputWarning)
    write(list(tests_of(*map(Path, sys.argv[1:]))))
