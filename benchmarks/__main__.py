"""Every measurement by its name: `python -m benchmarks [NAME ...]`; all of them without a name.

The opponents are torch where it is installed and, with `--reference`, the original
code. Numbers are printed and, with `--json`, written in one form (`timing.row`), of
which `--page` makes a page.
"""

import dataclasses
import importlib
import importlib.util
import json
import os
from pathlib import Path
from typing import Annotated, Literal, get_args

import tyro

from benchmarks.page import document
from benchmarks.timing import text
from neurosym_jax.commands._running import run_command
from neurosym_jax.configuration import Count, refuse
from neurosym_jax.errors import InputError
from neurosym_jax.runtime.files import write_text
from neurosym_jax.runtime.process import code_version, cpu_cores, run_environment

FORMAT = 1

Name = Literal[
    "zoo",
    "training",
    "symbols",
    "online",
    "age",
    "start",
    "reading",
    "scaling",
    "onnx",
    "node",
    "stream",
    "numeric",
    "trainings",
    "place",
]
NAMES: tuple[Name, ...] = get_args(Name)[:-6]
ON_GPU: tuple[Name, ...] = ("numeric", "scaling", "training", "zoo")


@dataclasses.dataclass(frozen=True)
class BenchmarkOptions:
    """Measure ours beside torch's, warm, in rounds that alternate; medians and spreads."""

    names: tyro.conf.Positional[tuple[Name, ...]] = NAMES
    """What to measure: the evaluation of the published checkpoints, training iterations, QTC and
    alpha of all pairs, online latency, the age of a forecast, whole processes, reading and
    windowing, scaling. Six run where they are named: onnx, exported models in ONNX Runtime; node,
    a robot's node with one; stream, a hundred thousand scenes in bounded memory; numeric, the tests
    of numbers; trainings, whole ones; and place, what a memory of a place costs."""
    gpu: bool = False
    """Measure what depends on an accelerator: numeric, scaling, training, and zoo where there are
    --data and --checkpoints. Without a GPU it runs on the CPU."""
    data: Annotated[Path | None, tyro.conf.arg(metavar="PATH")] = None
    """ETH/UCY as SGAN arranges it; zoo and reading need it, training takes it."""
    checkpoints: Annotated[Path | None, tyro.conf.arg(metavar="PATH")] = None
    """The folder of sgan-models and sgan-p-models; zoo needs it."""
    reference: Annotated[Path | None, tyro.conf.arg(metavar="PATH")] = None
    """A checkout of SGAN (agrimgupta92/sgan), measured too where torch is installed."""
    neurosym_reference: Annotated[Path | None, tyro.conf.arg(metavar="PATH")] = None
    """A checkout of NeuroSyM (sariahmghames/NeuroSyM-prediction), for symbols, likewise."""
    age_model: str = "recommended"
    """Model whose forecasts' age is measured; age needs ROS 1 (roscore)."""
    repeats: int = 5
    """Rounds that count."""
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """File for the numbers; those of other names in it are kept."""
    page: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Markdown page of all numbers in the file of `--json`."""

    @property
    def torch(self) -> bool:
        """Whether there is torch to compare with."""
        return importlib.util.find_spec("torch") is not None

    def need(self, name: Literal["data", "checkpoints"]) -> Path:
        """An option that a benchmark cannot do without."""
        value = getattr(self, name)
        if value is None:
            raise InputError(f"--{name} is needed for this")
        return value


def run(options: BenchmarkOptions) -> None:
    """Measure, print, write."""
    refuse(Count, {"--repeats": options.repeats})
    if options.page and not options.json:
        raise InputError("--page shows the numbers of a file: --json")
    if (options.reference or options.neurosym_reference) and not options.torch:
        raise InputError("the original code needs torch, which is not installed")
    if options.gpu and options.names != NAMES:
        raise InputError("--gpu says what is measured: name nothing else")
    names = ON_GPU if options.gpu else options.names
    if options.gpu and not (options.data and options.checkpoints):
        names = ON_GPU[:-1]
        print("zoo is left out: it needs --data and --checkpoints")
    needs = {
        "zoo": ("data", "checkpoints"),
        "reading": ("data",),
        "trainings": ("data",),
    }
    for name in names:
        absent = [
            need for need in needs.get(name, ()) if getattr(options, need) is None
        ]
        if absent:
            raise InputError(f"--{absent[0]} is needed for {name}")
    if options.gpu:
        # Contestants share the GPU's memory, and by default JAX takes most of it at once.
        os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    for name in names:
        result = importlib.import_module(f"benchmarks.{name}").measure(options)
        print(f"{name}: {text(result)}\n", flush=True)
        if options.json:
            machine = {
                **run_environment(),
                "cores": cpu_cores(),
                "commit": code_version(),
            }
            numbers = _write(options.json, name, {**result, "machine": machine})
            if options.page:
                write_text(options.page, document(numbers))


def _write(path: Path, name: str, result: dict) -> dict:
    data = (
        json.loads(path.read_text())
        if path.exists()
        else {"format": FORMAT, "benchmarks": {}}
    )
    data["benchmarks"][name] = result
    write_text(path, json.dumps(data, indent=1) + "\n")
    return data["benchmarks"]


if __name__ == "__main__":
    run_command(BenchmarkOptions, run, prog="python -m benchmarks")
