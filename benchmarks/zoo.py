"""Evaluation of SGAN's 20 published checkpoints, best of 20: ours, torch as it can be, and theirs.

Of the contestants, data and checkpoints are read before the clock starts; what is timed is
forecasting and errors, without collisions. All report the mean of the 20 joint ADEs, which
differ by their random numbers. Beside them is the user's command, a whole process: `evaluate.py`
from its start to its report, baselines included and figures not, with collisions and with
`--no-collisions`; its programs are in the cache.
"""

import functools
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.light import Work, decoding, encoding, limit, machine_rates
from benchmarks.timing import OURS, Row, alternate, row, rows

ROOT = Path(__file__).parents[1]
SAMPLES = 20


def measure(options: Any) -> dict[str, Any]:
    """See the module."""
    from neurosym_jax.data.sources import open_source
    from neurosym_jax.data.windows import cut_windows, make_batches
    from neurosym_jax.evaluation.metrics import metric_names
    from neurosym_jax.evaluation.scoring import score_forecaster
    from neurosym_jax.forecasting.model_folder import load_model

    source = open_source(options.need("data"))
    paths = sorted(options.need("checkpoints").glob("*/*_model.pt"))
    models = [load_model(path) for path in paths]
    windows = {
        (model.dataset, model.config.pred_len): cut_windows(
            source.recordings(str(model.dataset)), model.config.obs_len, model.config.pred_len
        )
        for model in models
    }
    tests = [windows[model.dataset, model.config.pred_len] for model in models]
    batches = {name: make_batches(test) for name, test in windows.items()}
    ades: dict[str, list[float]] = {}

    def ours() -> None:
        ades[OURS] = [
            score_forecaster(
                model.forecaster,
                model.params,
                batches[model.dataset, model.config.pred_len],
                samples=SAMPLES,
                seed=0,
                metrics=metric_names(collisions=False),
            ).mean("joint_ade")
            for model in models
        ]

    contestants: dict[str, Callable[[], object]] = {OURS: ours}
    if options.torch:
        contestants["torch peer"] = _peer(paths, tests, ades)
    seconds = alternate(contestants, options.repeats)
    if options.reference:
        seconds["original"] = [_original(options, paths, ades)]
    work = Work(0, 0)
    for model, test in zip(models, tests):
        pairs = float((test.sizes.astype(float) ** 2).sum())
        work += encoding(model.config, test.agents, pairs)
        work += decoding(model.config, test.agents, SAMPLES)
    table = [
        {**each, "ade": float(np.mean(ades[each["who"]]))}
        for each in rows(f"{len(paths)} checkpoints, best of {SAMPLES}", seconds)
    ]
    table += _commands(options, paths)
    light = limit(work, machine_rates(), table[0]["median"])
    return {"title": "evaluation of the published checkpoints", "rows": table, "light": light}


def _commands(options: Any, paths: list[Path]) -> list[Row]:
    """The user's command with collisions and without, in rounds that alternate."""
    command = [sys.executable, str(ROOT / "evaluate.py"), "--data", str(options.data.resolve())]
    command += ["--no-figures", "--json", "rows.json"]
    given = ["--checkpoint", *(str(path.resolve()) for path in paths)]
    with tempfile.TemporaryDirectory() as folder:
        run = functools.partial(
            subprocess.run, cwd=folder, check=True, stdout=subprocess.DEVNULL, text=True
        )
        contestants = {
            name: functools.partial(run, [*command, *more, *given])
            for name, more in (("with collisions", []), ("--no-collisions", ["--no-collisions"]))
        }
        seconds = alternate(contestants, options.repeats)
    case = f"evaluate.py, {len(paths)} checkpoints and baselines"
    return [row(case, name, values) for name, values in seconds.items()]


def _peer(paths: list[Path], tests: list[Any], ades: dict[str, list[float]]):
    import torch

    from benchmarks.torch_peer import TorchForecaster, chunks_of

    peers = [
        TorchForecaster.of(torch.load(path, map_location="cpu", weights_only=True))
        for path in paths
    ]
    chunks = {id(test): chunks_of(test) for test in tests}

    def run() -> None:
        ades["torch peer"] = [
            peer.evaluate(chunks[id(test)], SAMPLES)[0] for peer, test in zip(peers, tests)
        ]

    return run


def _original(options: Any, paths: list[Path], ades: dict[str, list[float]]) -> float:
    """Seconds of one round: it takes a minute or more."""
    import torch

    from benchmarks.original import Arguments, folder_of, load_script
    from neurosym_jax.data.readers.eth_ucy import SCENES

    script = load_script(options.reference, "evaluate_model")
    spent, found = 0.0, []
    for path in paths:
        checkpoint = torch.load(path, map_location="cpu", weights_only=True)
        generator = script.get_generator(checkpoint)
        args = Arguments(checkpoint["args"] | {"loader_num_workers": 0})
        names = SCENES[args.dataset_name]
        with folder_of([options.data / "all" / f"{name}.txt" for name in names]) as folder:
            _, loader = script.data_loader(args, folder)
        start = time.perf_counter()
        ade, _ = script.evaluate(args, loader, generator, SAMPLES)
        spent += time.perf_counter() - start
        found.append(float(ade))
    ades["original"] = found
    return spent
