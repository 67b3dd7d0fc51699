"""Small windows and a small recipe, so that a run takes a second once it is compiled."""

import dataclasses
import json

import jax
import numpy as np
import pytest
from matplotlib.figure import Figure
from orbax.checkpoint import v1 as ocp

from neurosym_jax.data.windows import Windows
from neurosym_jax.models.sgan.network import GeneratorConfig
from neurosym_jax.models.sgan.training import GeneratorRecipe
from neurosym_jax.training.batches import SceneStream
from neurosym_jax.training.run import Run
from tests.training.scripted import RECIPE as SCRIPTED_RECIPE
from tests.training.scripted import ScriptedConfig, register, standing, write_script

OBS, PRED = 4, 3
GENERATOR = GeneratorConfig(
    obs_len=OBS,
    pred_len=PRED,
    embedding_dim=4,
    encoder_h_dim=8,
    decoder_h_dim=8,
    mlp_dim=8,
    pooling="pool_net,bottleneck_dim=4,hidden_dim=16",
    noise_dim=2,
)
RECIPE = GeneratorRecipe(
    steps=75,
    batch_scenes=6,
    max_agents=6,
    best_k=3,
    validate_every=25,
    warmup_steps=5,
    ema=0.9,
)


def random_walks(sizes, seed=0) -> Windows:
    """Random walks in scenes of these many agents; the first agent of every other one stands."""
    rng = np.random.default_rng(seed)
    agents = sum(sizes)
    steps = rng.normal(0.3, 0.2, (agents, OBS + PRED, 2))
    start = rng.uniform(-3, 3, (agents, 1, 2))
    bounds = np.concatenate([[0], np.cumsum(sizes)])
    steps[bounds[:-1:2]] = 0
    identity = np.stack([np.full(len(sizes), seed), np.arange(len(sizes))], axis=1)
    return Windows(
        position=(start + np.cumsum(steps, axis=1)).round(4),
        agent=np.arange(agents),
        bounds=bounds,
        identity=identity.astype(np.uint32),
        obs_len=OBS,
    )


@pytest.fixture(scope="session")
def make_windows():
    return random_walks


@pytest.fixture(scope="session", autouse=True)
def cheap_classes():
    """Lets these few small scenes have several size classes, as real ones have."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("neurosym_jax.training.batches.COST_OF_A_CLASS", 20)
        yield


@pytest.fixture(scope="module")
def one_class():
    """Lets a step of anchors be one program, of scenes with up to 6 people."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("neurosym_jax.models.anchors.training.CLASSES", (6,))
        yield


@pytest.fixture(autouse=True)
def blank_curves(monkeypatch):
    """Leaves out of `curves.png` what takes time: axes. Fixtures of a module draw them."""
    monkeypatch.setattr(
        "neurosym_jax.plotting.plot_training", lambda *_, **__: Figure()
    )


@pytest.fixture(scope="session")
def windows(cheap_classes) -> Windows:
    return random_walks([2, 3, 4, 2, 7, 5, 3, 9, 2, 2, 11, 3, 4])


@pytest.fixture(scope="session")
def batch(windows):
    """`batch(n)`: the groups of one batch of n scenes."""

    def groups(scenes):
        steps = SceneStream(windows, scenes, seed=0).steps(0, 1)
        return jax.tree.map(lambda leaf: leaf[0], steps)

    return groups


@pytest.fixture(scope="session")
def run(windows) -> Run:
    return Run(
        GENERATOR, RECIPE, windows, random_walks([3, 3, 4], seed=1), "zara1", ("walks",)
    )


@pytest.fixture(scope="session")
def files(tmp_path_factory):
    """Two recordings of people who walk about."""
    folder = tmp_path_factory.mktemp("data")
    rng = np.random.default_rng(0)
    for name, frames in (("walk", 60), ("check", 30)):
        start = rng.uniform(-3, 3, (5, 1, 2))
        position = start + rng.normal(0.1, 0.2, (5, frames, 2)).cumsum(1)
        lines = []
        for frame in range(frames):
            for person, (x, y) in enumerate(position[:, frame]):
                lines.append(f"{10 * frame}\t{person}\t{x:.3f}\t{y:.3f}\n")
        (folder / f"{name}.txt").write_text("".join(lines))
    return folder


def with_recipe(run, **changes) -> Run:
    """The run with changes to its recipe."""
    return dataclasses.replace(run, recipe=dataclasses.replace(run.recipe, **changes))


@pytest.fixture(scope="session")
def final():
    """`final(folder)` of a run: the leaves of its last state, its model's digest, its metrics."""

    def read(folder):
        state = ocp.load(str(max((folder / "checkpoints").glob("step_*")) / "state"))
        model = json.loads((folder / "model" / "config.json").read_text())
        leaves = {name: array.tobytes() for name, array in state.items()}
        return leaves, model["sha256"], (folder / "metrics.jsonl").read_bytes()

    return read


@pytest.fixture(scope="session")
def interrupt_at():
    """`interrupt_at(step)`: a function of a run's rows that is a Ctrl-C at this step."""

    def make(step):
        def interrupt(row):
            if row["step"] == step:
                raise KeyboardInterrupt

        return interrupt

    return make


@pytest.fixture
def scripted(run):
    """A run of the family that follows a script, of people who stand."""
    register()
    write_script()
    windows = {
        name: standing(getattr(run, name)) for name in ("training", "validation")
    }
    config = ScriptedConfig(OBS, PRED)
    return Run(config, SCRIPTED_RECIPE, **windows, dataset="zara1", data=("walks",))
