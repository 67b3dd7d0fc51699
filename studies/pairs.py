"""`docs/pairs.csv`: what a person's future owes to where others went, by geometry and by symbols.

python -m studies.pairs DATA CORRIDORS > docs/pairs.csv

DATA is ETH/UCY as SGAN arranges it, CORRIDORS the folder `tests` of
`studies.more_data`. Of every person of every third scene at 8 + 12: the gain in nats of
the truth's probability among the points of the network, if each point weighs exp(-w f)
in place of equally. Features f of a point and the true futures of others are those of
`models.anchors.draws` (overlap, parting), or of the pair's QTC_C1 symbols, the mean
over people within some 4 m. Weights w are those by which scenes are drawn, or maximise
the gain at all other places (Besag's pseudo-likelihood). Half of a 95 % interval,
Student's t over 20 blocks of scenes.
"""

import csv
import functools
import sys
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from jax import Array
from jax.scipy.optimize import minimize

from neurosym_jax.data.recordings import SCENES, recordings_in, split_files
from neurosym_jax.data.windows import Windows, cut_windows, single_scene
from neurosym_jax.evaluation.intervals import student_half
from neurosym_jax.forecasting.model import Model
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.models.anchors.draws import COHESION, REPULSION, nearest, pair_terms
from neurosym_jax.models.anchors.forecaster import apply_anchors
from neurosym_jax.models.anchors.frames import SLOW
from neurosym_jax.runtime.process import enable_compilation_cache, tune
from neurosym_jax.scene import Scene
from neurosym_jax.symbolic.qtc import observe
from studies.points import CHECKPOINTS

STEPS, SKIP, BLOCKS = (8, 12), 3, 20
WIDTH = 0.25
"""Root mean square error in metres at which a point is 0.6 times as near to the truth as can be."""
DRAWN = np.array([REPULSION, COHESION, 0, 0, 0, 0, 0])
ARMS = {
    "as drawn": None,
    "overlap and parting": [0, 1],
    "changes of symbols": [2],
    "symbols": [2, 3, 4, 5, 6],
    "both": [0, 1, 2, 3, 4, 5, 6],
}
"""Which features have weights; None for those of the draws."""


def places(data: Path, corridors: Path) -> dict[str, tuple[Windows, Model]]:
    """The test windows of each place, and a network that has not learned them."""
    files = {
        name: (split_files(data, name, "test"), f"anchors_{name}_12") for name in SCENES
    }
    files["corridors"] = sorted(corridors.glob("bo*")), "anchors_general_12"
    return {
        name: (
            cut_windows(recordings_in(map(str, paths)), *STEPS),
            load_model(CHECKPOINTS / network),
        )
        for name, (paths, network) in files.items()
    }


@functools.partial(jax.jit, static_argnums=0)
def features(config: Any, params: Any, scene: Scene) -> tuple[Array, Array]:
    """[N, P, 7] features of each person's points, and [N, P] how near each is to the truth."""
    observed, future = jnp.asarray(scene.observed), jnp.asarray(scene.known_future)
    points = apply_anchors(config, params, scene).points
    count = len(points)
    square = jnp.square(points - future).sum(-1).mean(-1).T
    nearness = jax.nn.softmax(-square / WIDTH**2 / 2)
    near, present = nearest(points, jnp.asarray(scene.valid))
    # As a further point, the truth: theirs is the last row of tables.
    extended = jnp.concatenate([points, future[None]])
    terms = pair_terms(extended, scene, near, present, config.period)
    geometry = jnp.stack([term[:, :, count, :count].sum(1) for term in terms], -1)
    distance = jnp.linalg.norm(observed[:, None, -1] - observed[near, -1], axis=-1)
    seen = jnp.where(present, jnp.exp(-jnp.square(distance / 4)), 0)
    seen = seen / jnp.maximum(seen.sum(1, keepdims=True), 1)
    symbols = _symbols(points, future, observed, near, SLOW * config.period)
    return jnp.concatenate(
        [geometry, jnp.einsum("nm,nmpf->npf", seen, symbols)], -1
    ), nearness


def _symbols(
    points: Array, future: Array, observed: Array, near: Array, least: float
) -> Array:
    """[N, M, P, 5]: changes of symbols from now on, and means of towards and sides over time.

    Steps shorter than `least` metres are none.
    """
    paths = jnp.concatenate(
        [observed[None, :, -2:].repeat(len(points), 0), points], axis=2
    )
    others = jnp.concatenate([observed[:, -2:], future], axis=1)[near]
    own = paths.swapaxes(0, 1)[:, None]  # [N, 1, P, T, 2]
    states = observe(
        own,
        others[:, :, None],
        quantisation_factor=least,
        side_quantisation_factor=least,
    ).astype(jnp.float32)
    towards, sides = states[..., 1:, :2], states[..., 1:, 2:]
    changes = jnp.abs(jnp.diff(states, axis=-2)).sum((-1, -2)) / 10
    means = [towards.prod(-1), sides.prod(-1), towards.sum(-1)]
    means.append(jnp.abs(sides[..., 0] - sides[..., 1]))
    return jnp.stack([changes, *(mean.mean(-1) for mean in means)], -1)


def gain(weights: Array, feature: Array, nearness: Array) -> Array:
    """[people] nats by which the truth is more probable than among equally probable points."""
    share = jax.nn.log_softmax(-feature @ weights)
    return jax.nn.logsumexp(share + jnp.log(nearness + 1e-12), axis=-1) + jnp.log(
        share.shape[1]
    )


def fitted(chosen: list[int], training: list[tuple[Array, Array]]) -> Array:
    """[7] weights of the features `chosen` that maximise the mean gain over places."""
    mask = jnp.zeros(len(DRAWN)).at[jnp.array(chosen)].set(1)

    @jax.jit
    def loss(weights: Array) -> Array:
        gains = jnp.stack([gain(weights * mask, *each).mean() for each in training])
        return 1e-4 * jnp.square(weights).sum() - gains.mean()

    found = minimize(loss, jnp.ones(len(DRAWN)), method="BFGS")
    return found.x * mask


def main(
    data: tyro.conf.Positional[Path], corridors: tyro.conf.Positional[Path]
) -> None:
    """Print the table."""
    people = {}
    for name, (windows, model) in places(data, corridors).items():
        parts = []
        for number in range(0, windows.scenes, SKIP):
            scene = single_scene(windows, number).replace(origin=None, extras={})
            parts.append(
                [
                    each[scene.valid]
                    for each in features(model.config, model.params, scene)
                ]
            )
        people[name] = tuple(jnp.concatenate(each) for each in zip(*parts))
    lines = csv.writer(sys.stdout, lineterminator="\n")
    lines.writerow(["place", "people", *ARMS])
    for name, (feature, nearness) in people.items():
        line = [name, str(len(feature))]
        for chosen in ARMS.values():
            training = [each for other, each in people.items() if other != name]
            weights = jnp.asarray(DRAWN) if chosen is None else fitted(chosen, training)
            gains = np.asarray(gain(weights, feature, nearness))
            means = [block.mean() for block in np.array_split(gains, BLOCKS)]
            line.append(f"{gains.mean():+.2f} ±{student_half(means):.2f}")
        lines.writerow(line)


if __name__ == "__main__":
    tune()
    enable_compilation_cache()
    tyro.cli(main, prog="python -m studies.pairs")
