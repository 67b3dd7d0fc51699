"""Evaluation of SGAN's 20 published checkpoints, best of 20: ours, torch as it can be, and theirs.

Of the contestants, data and checkpoints are read before the clock starts; what is timed
is forecasting and errors, without collisions. All report the mean of the 20 joint ADEs,
which differ by their random numbers. Beside them is the user's command, a whole
process: `evaluate.py` from its start to its report, baselines included and figures not,
with collisions and with `--no-collisions`; its programs are in the cache.
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
from benchmarks.timing import OURS, Row, Timing, alternate, peak_mb, row, rows

ROOT = Path(__file__).parents[1]
SAMPLES = 20


def measure(options: Any) -> dict[str, Any]:
    """See the module."""
    paths = sorted(options.need("checkpoints").glob("*/*_model.pt"))
    arguments = paths, options.need("data")
    contestants = {OURS: functools.partial(_ours, *arguments)}
    if options.torch:
        contestants["torch peer"] = functools.partial(_peer, *arguments)
    timings = alternate(contestants, options.repeats)
    if options.reference:
        timings["original"] = _original(options, paths)
    work = Work(0, 0)
    models, tests = _models_and_tests(*arguments)
    for model, test in zip(models, tests):
        pairs = float((test.sizes.astype(float) ** 2).sum())
        work += encoding(model.config, test.agents, pairs)
        work += decoding(model.config, test.agents, SAMPLES)
    table = [
        {**row, "ade": timings[row["who"]].result}
        for row in rows(f"{len(paths)} checkpoints, best of {SAMPLES}", timings)
    ]
    table += _commands(options, paths)
    light = limit(work, machine_rates(), table[0]["median"])
    return {
        "title": "evaluation of the published checkpoints",
        "rows": table,
        "light": light,
    }


def _models_and_tests(paths: list[Path], data: Path) -> tuple[list[Any], list[Any]]:
    """The checkpoints, and the windows that each is tested on."""
    from neurosym_jax.data.recordings import open_source
    from neurosym_jax.data.windows import cut_windows
    from neurosym_jax.models.disk import load_model

    source, models = open_source(data), [load_model(path) for path in paths]

    @functools.cache
    def windows(place: str, *lengths: int) -> Any:
        return cut_windows(source.recordings(place), *lengths)

    lengths = [(model.config.obs_len, model.config.pred_len) for model in models]
    return models, [
        windows(str(model.dataset), *steps) for model, steps in zip(models, lengths)
    ]


def _ours(paths: list[Path], data: Path) -> Callable[[], float]:
    from neurosym_jax.data.windows import make_batches
    from neurosym_jax.evaluation.metrics import metric_names
    from neurosym_jax.evaluation.scores import score_forecaster

    models, tests = _models_and_tests(paths, data)
    batches = {id(test): make_batches(test) for test in tests}
    settings = {
        "samples": SAMPLES,
        "seed": 0,
        "metrics": metric_names(collisions=False),
    }

    def run() -> float:
        results = [
            score_forecaster(
                model.forecaster, model.params, batches[id(test)], **settings
            )
            for model, test in zip(models, tests)
        ]
        return float(np.mean([result.mean("joint_ade") for result in results]))

    return run


def _commands(options: Any, paths: list[Path]) -> list[Row]:
    """The user's command with collisions and without, in rounds that alternate."""
    command = [
        sys.executable,
        str(ROOT / "evaluate.py"),
        "--data",
        str(options.data.resolve()),
    ]
    command += ["--no-figures", "--json", "rows.json"]
    checkpoints = ["--model", *(str(path.resolve()) for path in paths)]
    with tempfile.TemporaryDirectory() as folder:
        run = functools.partial(
            subprocess.run, cwd=folder, check=True, stdout=subprocess.DEVNULL, text=True
        )
        seconds: dict[str, list[float]] = {"with collisions": [], "--no-collisions": []}
        for _ in range(1 + options.repeats):
            for name, values in seconds.items():
                start = time.perf_counter()
                run(
                    [*command, *([name] if name.startswith("--") else []), *checkpoints]
                )
                values.append(time.perf_counter() - start)
    case = f"evaluate.py, {len(paths)} checkpoints and baselines"
    return [row(case, name, values[1:]) for name, values in seconds.items()]


def _peer(paths: list[Path], data: Path) -> Callable[[], float]:
    import torch

    from benchmarks.torch_peer import TorchForecaster, chunks_of, use_accelerator

    use_accelerator()
    _, tests = _models_and_tests(paths, data)
    peers = [
        TorchForecaster.of(torch.load(path, map_location="cpu", weights_only=True))
        for path in paths
    ]
    chunks = {id(test): chunks_of(test) for test in tests}

    def run() -> float:
        ades = [
            peer.evaluate(chunks[id(test)], SAMPLES)[0]
            for peer, test in zip(peers, tests)
        ]
        return float(np.mean(ades))

    return run


def _original(options: Any, paths: list[Path]) -> Timing:
    """One round: it takes a minute or more."""
    import torch

    from benchmarks.original import Arguments, folder_of, load_script
    from neurosym_jax.data.recordings import SCENES

    script = load_script(options.reference, "evaluate_model")
    spent, cpu, ades = 0.0, 0.0, []
    for path in paths:
        checkpoint = torch.load(path, map_location="cpu", weights_only=True)
        generator = script.get_generator(checkpoint)
        args = Arguments(checkpoint["args"] | {"loader_num_workers": 0})
        names = SCENES[args.dataset_name]
        with folder_of(
            [options.data / "all" / f"{name}.txt" for name in names]
        ) as folder:
            _, loader = script.data_loader(args, folder)
        start, cpu_start = time.perf_counter(), time.process_time()
        ade, _ = script.evaluate(args, loader, generator, SAMPLES)
        spent += time.perf_counter() - start
        cpu += time.process_time() - cpu_start
        ades.append(float(ade))
    return Timing([spent], [cpu], peak_mb(), float(np.mean(ades)))
