"""What the work of a command is, in counts that no other process can disturb.

python -m benchmarks.counts            # prints them
python -m benchmarks.counts --write    # makes them the baseline

`tests/test_benchmarks.py` fails where one is above `benchmarks/baseline.json`. FLOPs
and bytes are those of XLA's cost analysis of the program before it is optimised, in
which the body of a loop over steps counts once: they show growth, not the work (which
`benchmarks.light` has).

Collisions are looked for on the host. Their share is of the arithmetic of the forecast
they are looked for in, both in elementwise operations: a core does some 50 FLOPs of a
matrix product, or one tanh, in the time of one of numpy's.
"""

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

BASELINE = Path(__file__).with_name("baseline.json")
PEOPLE, SAMPLES = 16, 20
FLOPS_OF_AN_OPERATION = 50


def counts() -> dict[str, float]:
    """Programs of each command, FLOPs and bytes of a forecast and a training step, collisions."""
    return {
        **_programs(),
        **_costs(),
        **_training_costs(),
        "collisions of a crowd's forecast": collision_share(),
    }


def _programs() -> dict[str, float]:
    import jax
    import numpy as np

    from neurosym_jax.commands.evaluate import Options, run
    from neurosym_jax.data.tables import ReadOptions
    from neurosym_jax.models import GeneratorConfig, NoPooling
    from neurosym_jax.models.disk import load_model
    from neurosym_jax.models.forecast import predict
    from neurosym_jax.training.loop import train
    from neurosym_robot.online.predictor import Predictor

    compiled = 0

    def count(event: str, duration: float, **_: Any) -> None:
        nonlocal compiled
        compiled += event == "/jax/core/compile/backend_compile_duration"

    jax.monitoring.register_event_duration_secs_listener(count)
    counts: dict[str, float] = {}

    def done(name: str) -> None:
        nonlocal compiled
        counts[f"programs: {name}"], compiled = compiled, 0
        jax.clear_caches()

    names = ("sgan_simulations_8", "neurosym_simulations_8")
    sgan = load_model(names[0])
    predict(sgan, np.zeros((5, 8, 2)))
    done("a forecast")
    Predictor(sgan, max_people=64)
    done("an online predictor for 64 people")
    with tempfile.TemporaryDirectory() as folder:
        options = {
            "json": Path(folder) / "rows.json",
            "figures": False,
            "collisions": False,
        }
        run(Options(model=names, dataset="cross-path", **options))
    done("the evaluation of two models on a scene")
    windows = _windows()
    with tempfile.TemporaryDirectory() as folder:
        settings = {
            "config": GeneratorConfig(pooling=NoPooling()),
            "recipe": _recipe("ours"),
        }
        settings["read"] = ReadOptions(allow=("seen",))
        train(windows, windows, Path(folder) / "run", **settings)
    done("a training run")
    return counts


def _windows() -> Any:
    """Those of a simulation."""
    from neurosym_jax.data.recordings import Synthetic
    from neurosym_jax.data.windows import cut_windows

    return cut_windows(Synthetic().recordings("cross-path", "val"), 8, 8)


def _recipe(name: str) -> Any:
    """A step on one class of scenes, the least to compile."""
    from neurosym_jax.training.run import make_recipe

    return make_recipe(
        name, steps=1, changes=["batch_scenes=4", "best_k=2", "max_agents=2"]
    )


def _training_costs() -> dict[str, float]:
    import jax

    from neurosym_jax.models.forecaster import forecaster_of
    from neurosym_jax.models.sgan.network import POOLINGS
    from neurosym_jax.models.sgan.training import init_state, train_steps
    from neurosym_jax.training.batches import SceneStream
    from neurosym_jax.training.run import make_config

    counts: dict[str, float] = {}
    key = jax.eval_shape(lambda: jax.random.key(0))
    # SGAN with its discriminator, which takes a batch of its own.
    for model, recipe in (("sgan", _recipe("sgan")), ("neurosym", _recipe("ours"))):
        config = make_config(model)
        batches = 2 if recipe.adversarial_weight else 1
        stream = SceneStream(
            _windows(), recipe.batch_scenes, recipe.seed, recipe.max_agents
        )
        groups = stream.steps(0, batches)
        state = jax.eval_shape(lambda key: init_state(config, recipe, key), key)  # noqa: B023
        step = jax.tree.map(lambda leaf: leaf[None], groups)
        pooling = POOLINGS.name_of(config.pooling)
        forecaster = forecaster_of(config)
        program = train_steps.lower(forecaster, recipe, key, state, step)
        cost: Any = program.cost_analysis()
        counts[f"MFLOP: a training step, {pooling}"] = round(cost["flops"] / 1e6, 3)
        counts[f"MB: a training step, {pooling}"] = round(
            cost["bytes accessed"] / 1e6, 3
        )
    return counts


def _costs() -> dict[str, float]:
    import jax
    import numpy as np

    from neurosym_jax.models import Generator, GeneratorConfig
    from neurosym_jax.models.forecast import forecast_scene
    from neurosym_jax.models.sgan.forecaster import GeneratorForecaster
    from neurosym_jax.models.sgan.network import POOLINGS
    from neurosym_jax.scene import make_scene, pad_scene

    counts: dict[str, float] = {}
    for pooling in ("none", "pool_net", "as_described"):
        config = GeneratorConfig(pooling=POOLINGS[pooling]())
        scene = pad_scene(make_scene(np.zeros((1, 8, 2))), PEOPLE).replace(origin=None)
        noise, alpha = np.zeros(config.noise_dim), np.zeros((PEOPLE, PEOPLE, 8))
        params = jax.eval_shape(
            Generator(config).init, jax.random.key(0), scene, noise, alpha
        )
        noises = np.zeros((SAMPLES, config.noise_dim), np.float32)
        forecaster = GeneratorForecaster(config)
        cost: Any = forecast_scene.lower(
            forecaster, params, scene, noises
        ).cost_analysis()
        counts[f"MFLOP: a forecast, {pooling}"] = round(cost["flops"] / 1e6, 3)
        counts[f"MB: a forecast, {pooling}"] = round(cost["bytes accessed"] / 1e6, 3)
    return counts


def collision_share() -> float:
    """Work of finding collisions over that of forecasting, of a crowd as dense as univ's."""
    import numpy as np

    from benchmarks.light import decoding, encoding
    from benchmarks.operations import operations
    from neurosym_jax.evaluation import collisions
    from neurosym_jax.models.sgan.network import GeneratorConfig

    people, config = 40, GeneratorConfig(pred_len=12)
    draw = np.random.default_rng(0)
    step = draw.normal(0, 0.3, (people, 1, 2)) + draw.normal(
        0, 0.1, (SAMPLES, people, 12, 2)
    )
    futures = draw.uniform(0, 14, (people, 1, 2)) + step.cumsum(axis=2)
    counts = operations(collisions, futures.astype(np.float32), np.ones(people, bool))
    work = encoding(config, people, people**2) + decoding(config, people, SAMPLES)
    return round(
        counts / (work.flops / FLOPS_OF_AN_OPERATION + work.transcendentals), 4
    )


if __name__ == "__main__":
    # Printed last, after what the commands say.
    text = json.dumps(counts(), indent=1)
    if sys.argv[1:] == ["--write"]:
        BASELINE.write_text(text + "\n")
    print(text)
