"""Every option of every command changes what is done, or is refused.

`CASES` has a command line for each option that the parsers have.
"""

import contextlib
import shlex
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from neurosym_jax.__main__ import commands
from neurosym_jax.data.sources import open_source
from neurosym_jax.evaluation.plan import load_tests, make_plan
from neurosym_jax.evaluation.results import Settings, evaluate_tests
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.interop.parity import Parity
from tests.commands.walk import (
    READ,
    TABLE,
    assert_it_matters,
    assert_repeated,
    done,
    options_of,
    write_data,
)

SMALL = Path(__file__).parents[1] / "golden" / "small.pt"
CORE = [name for name, module in commands().items() if module.startswith("neurosym_jax.")]
C, LENGTHS = "neurosym_jax.commands", "--obs-len 4 --pred-len 4"
OF_READING = {
    "train": "--train-on {d}/a/%s --validate-on {d}/b/%s --obs-len 4 --pred-len 4",
    "evaluate": "--data {d}/a/%s --no-figures",
    "inspect": "{d}/a/%s",
    "symbols": "{d}/a/%s --forecast --model sgan_zara1_8",
}
BASE = {command: line.replace("%s", "walk.txt") for command, line in OF_READING.items()} | {
    "sweep": f"--data {{d}}/a {LENGTHS} --seed 0 --dataset walk",
    "report": "sweep",
    "parity": "--torch-module m.py:M --checkpoint c.pt --keep kept",
    "convert": f"{SMALL} new",
    "export": "sgan_zara1_8 new",
    "download": "eth-ucy",
    "models": "",
}
TWO = f"--data {{d}}/a {LENGTHS}"
NEURO = f"{BASE['train']} --model neurosym"
WEIGHTS, N = "{d}/a/walk.txt", "neurosym_zara1_8"
LATEX = BASE["evaluate"]
FLOOR = "{d}/a/walk.txt --figure f.png --underlay {d}/%s/floor.png --homography {d}/a/h.txt"
CASES = {
    "train": {
        "--model": "--model anchors",
        "--pooling": "--pooling none",
        "--weighting": (NEURO, f"{NEURO} --weighting ones"),
        "--dataset": (f"{TWO} --dataset walk", f"{TWO} --dataset gap"),
        "--obs-len": "--obs-len 5",
        "--pred-len": "--pred-len 5",
        "--period": "--period 0.5",
        "--recipe": "--recipe sgan",
        "--seed": "--seed 1",
        "--steps": "--steps 7",
        "--set": "--set ema=0.5",
        "--network": "--network encoder_h_dim=16",
        "--data": (f"{TWO} --dataset walk", f"--data {{d}}/b {LENGTHS} --dataset walk"),
        "--train-on": "--train-on {d}/a/gap.txt",
        "--validate-on": "--validate-on {d}/b/gap.txt",
        "--train-also": "--train-also {d}/a/gap.txt",
        "--out": "--out here",
        "--resume": "--resume",
        "--log": "--log tensorboard",
    },
    "sweep": {
        "--model": "--model anchors",
        "--pooling": "--pooling none",
        "--weighting": "--weighting ones soft",
        "--dataset": "--dataset gap",
        "--obs-len": "--obs-len 5",
        "--pred-len": "--pred-len 4 12",
        "--period": "--period 0.5",
        "--recipe": "--recipe sgan",
        "--seed": "--seed 0 1",
        "--steps": "--steps 7",
        "--set": "--set ema=0.5",
        "--network": "--network encoder_h_dim=16",
        "--data": "--data {d}/b",
        "--train-also": "--train-also {d}/b",
        "--out": "--out here",
        "--jobs": "--jobs 3",
        "--log": "--log tensorboard",
        "--dry-run": "--dry-run",
        **{option: said for option, (_, said, *_) in READ.items()},
    },
    "evaluate": {
        "--checkpoint": "--checkpoint sgan_simulations_8",
        "--all": "--all",
        "--data": "--data {d}/b/walk.txt",
        "--dataset": (TWO, f"{TWO} --dataset walk"),
        "--test-on": (TWO, f"{TWO} --test-on walk"),
        "--obs-len": "--obs-len 5",
        "--pred-len": "--pred-len 5",
        "--period": "--period 0.5",
        "--samples": "--samples 3",
        "--seed": "--seed 1",
        "--seeds": "--seeds 2",
        "--protocol": "--protocol joint-metrics",
        "--min-agents": "--min-agents 1",
        "--baselines": "--baselines constant_velocity_sampled",
        "--metrics": "--metrics crps",
        "--symbols": "--symbols",
        "--collisions": "--no-collisions",
        "--table": "--table csv",
        "--intervals": (f"{LATEX} --table latex", f"{LATEX} --table latex --intervals"),
        "--json": "--json here.json",
        "--figures": "--figures",
        "--plots": ("--data {d}/a/walk.txt", "--data {d}/a/walk.txt --plots here.png"),
        "--style": ("--data {d}/a/walk.txt", "--data {d}/a/walk.txt --style talk"),
        "--save-forecasts": "--save-forecasts here.npz",
        "--cluster": "--cluster tcp://there",
    },
    "symbols": {
        "DATA": ("{d}/a/walk.txt", "{d}/b/walk.txt"),
        "--dataset": ("{d}/a", "{d}/a --dataset walk"),
        "--window": "--window 3",
        "--weighting": (WEIGHTS, f"{WEIGHTS} --weighting quantised"),
        "--model": "--model anchors_eth_12",
        "--forecast": (f"{WEIGHTS} --model {N}", f"{WEIGHTS} --model {N} --forecast"),
        "--samples": "--samples 3",
        "--seed": "--seed 3",
        "--out": "--out here",
        "--style": (WEIGHTS, f"{WEIGHTS} --style talk"),
    },
    "inspect": {
        "PATH": ("{d}/a/walk.txt", "{d}/b/walk.txt"),
        "--figure": "--figure f.png",
        "--underlay": (FLOOR % "a", FLOOR % "b"),
        "--homography": (FLOOR % "a", f"{FLOOR % 'a'} --homography {{d}}/b/h.txt"),
        "--style": ("{d}/a/walk.txt --figure f.png", "{d}/a/walk.txt --figure f.png --style talk"),
    },
    "convert": {
        "MODEL": (f"{SMALL} new", "sgan_zara1_8 new"),
        "TO": (f"{SMALL} new", f"{SMALL} new.pt"),
        "--ignore-arg": "--ignore-arg mine",
    },
    "export": {
        "MODEL": ("sgan_zara1_8 new", "anchors_eth_12 new"),
        "TO": ("sgan_zara1_8 new", "sgan_zara1_8 newer"),
        "--samples": "--samples 3",
    },
    "download": {
        "WHAT": ("eth-ucy", "sgan-checkpoints"),
        "--to": "--to here",
        "--mirror": "--mirror https://there",
        "--timeout": "--timeout 3",
    },
    "models": {},
    "parity": {
        "DIRECTORY": ("one", "other"),
        "--torch-module": "--torch-module m.py:N",
        "--checkpoint": "--checkpoint d.pt",
        "--python": "--python python9",
        "--seed": "--seed 1",
        "--keep": "--keep here",
        "--tolerance": "--tolerance 0.1",
    },
    "report": {
        "SWEEP": ("sweep", "other"),
        "--against": "--against cnd",
        "--pred-len": "--pred-len 12",
        "--out": "--out here.md",
    },
}
for command, line in OF_READING.items():
    for option, (file, said, *error) in READ.items():
        base = line.replace("%s", file)
        CASES[command][option] = (base, f"{base} {said}", *error)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = write_data(tmp_path_factory.mktemp("data"))
    for seed, name in enumerate("ab"):
        Image.new("L", (3, 3), 99 * seed).save(folder / name / "floor.png")
        np.savetxt(folder / name / "h.txt", (seed + 1) * np.eye(3) + np.eye(3)[::-1] / 9)
    return folder


@pytest.fixture(scope="module")
def inner(data):
    """By command: what is recorded and not run, and what it returns."""
    source = open_source(data / "a" / "walk.txt")
    results = list(evaluate_tests(load_tests(source, make_plan(source, [])), Settings(2)))
    figure = {
        "neurosym_jax.plotting.save_figure": Path("figure.png"),
        "neurosym_jax.plotting.use_style": None,
    }
    shipped = [load_model.__globals__["find_model"](n) for n in ("sgan_simulations_8",)]
    return {
        "train": {
            f"{C}.train.train_run": None,
            f"{C}.train._print_errors": None,
            f"{C}.train._tensorboard": lambda: contextlib.nullcontext(print),
        },
        "sweep": {f"{C}.sweep.run_sweep": 0},
        "evaluate": {
            f"{C}.evaluate.evaluate_tests": lambda: iter(results),
            f"{C}.evaluate.cluster_map": lambda: contextlib.nullcontext("cluster"),
            f"{C}.evaluate.shipped_models": shipped,
            f"{C}.evaluate.save_forecasts": [Path("f.npz")],
            "neurosym_jax.plotting.evaluation.draw_figures": [Path("f.png")],
            "neurosym_jax.plotting.use_style": None,
        },
        "symbols": {
            f"{C}.symbols.predict": np.zeros((2, 5, 8, 2)),
            f"{C}.symbols.forecast_rows": [],
            **figure,
        },
        "inspect": figure | {"neurosym_jax.plotting.plot_tracks": None},
        "convert": {
            f"{C}.convert.{name}": SimpleNamespace(name="model")
            for name in ("load_model", "load_torch_checkpoint", "save_model")
        }
        | {f"{C}.convert.export_torch_checkpoint": None},
        "export": {
            f"{C}.export.load_model": SimpleNamespace(name="model"),
            f"{C}.export.export_model": b"",
        },
        "download": {f"{C}.download.download": (1, 1)},
        "parity": {
            f"{C}.parity.run_parity": Parity(()),
            f"{C}.parity.run_torch": None,
            f"{C}.parity.new_folder": lambda: contextlib.nullcontext("kept"),
            f"{C}.parity.load_torch_checkpoint": SimpleNamespace(assumed=()),
        },
        "report": {f"{C}.report.write_report": ""},
        "models": {f"{C}.models.models_at_hand": []},
    }


@pytest.mark.parametrize(
    ("command", "option"), [(name, option) for name in CORE for option in options_of(name)]
)
def test_it_changes_what_is_done(command, option, data, inner, tmp_path, capsys):
    case = CASES[command][option]

    assert_it_matters(command, BASE[command], case, inner[command], data, tmp_path, capsys)


@pytest.mark.parametrize("command", CORE)
def test_nothing_changes_by_itself(command, data, inner, tmp_path, capsys):
    assert_repeated(command, BASE[command], inner[command], data, tmp_path, capsys)


REFUSED = {
    "train --weighting quantised --steps 1": "--weighting quantised: sgan weights no pairs",
    "train --model neurosym --pooling none": "--pooling none: neurosym has as_described",
    "train --variant encounter": "--variant",
    "train --recipe anchors": "the recipe does not fit the network: --recipe ours, sgan",
    "train --train-on a --validate-on b --dataset c": "--dataset: has no effect with --train-on",
    "train --fps 25": "--fps: has no effect on simulations",
    "sweep --keep robot --dry-run": "--keep: has no effect on simulations",
    "sweep --resume": "--resume",
    "sweep --train-on a --validate-on b": "--train-on",
    "evaluate --max-gap 2": "--max-gap: has no effect on simulations",
    "evaluate --all --checkpoint a": "--checkpoint: has no effect with --all",
    "evaluate --no-figures --plots a.png": "--plots: has no effect with --no-figures",
    "symbols --unit cm": "--unit: has no effect on simulations",
    "symbols --forecast --style talk": "--style: has no effect with --forecast",
    "evaluate --no-figures --style talk": "--style: has no effect with --no-figures",
    "inspect a --style talk": "--style: has no effect without --figure",
    "inspect a --figure b.png --homography c": "--homography: has no effect without --underlay",
    "inspect a --figure b.png --underlay c": "--underlay: needs a --homography",
    "symbols --samples 3": "--samples: has no effect without --forecast",
    "symbols --forecast --weighting cnd": "--weighting: has no effect with --forecast",
    "parity cases --seed 1": "--seed: has no effect on stored cases",
    "download thor --mirror a": "--mirror: has no effect on THÖR",
    "train absent.yaml": "absent.yaml: cannot be read: [Errno 2]",
    "train 'stepps: 3'": "unknown option 'stepps': did you mean --steps?",
    "sweep 'seeds: [0, 1]'": "unknown option 'seeds': did you mean --seed?",
    "train 'steps: 3\nsteps: 4'": "the option 'steps' stands twice",
    "train 'steps: [3'": "cannot be read: while parsing",
    "train '- steps'": "must have a line `option: value` for each option",
}


@pytest.mark.parametrize("line", REFUSED)
def test_what_has_no_effect_is_refused(line, tmp_path, capsys):
    command, *rest = shlex.split(line)
    if " " in rest[0]:
        (tmp_path / "recipe.yaml").write_text(rest[0])
        rest[0] = str(tmp_path / "recipe.yaml")
    (status, *_, out), error = done([command, *rest], {}, tmp_path / "run", capsys)
    assert status == 2
    assert REFUSED[line] in out + error


def test_a_file_is_a_command_line_that_options_override(data, inner, tmp_path, capsys):
    (file := tmp_path / "recipe.yaml").write_text(
        f"""
        train_on: [{data}/a/tables/odd.csv]
        validate-on: {data}/b/tables/odd.csv
        columns: {{time: t, id: who, x: px, y: py}}
        set: {{ema: 0.5, rotate: 0, max_agents: null}}
        obs_len: 4
        resume: true
        seed: 7
        """
    )
    read = f"--train-on {data}/a/tables/odd.csv --validate-on {data}/b/tables/odd.csv"
    read += f" --columns {TABLE} --obs-len 4 --resume --set ema=0.5 rotate=0 max_agents=null"
    found = [
        done(["train", *shlex.split(line)], inner["train"], tmp_path / str(at), capsys)
        for at, line in enumerate((f"{file} --seed 1", f"{read} --seed 1", f"{read} --seed 7"))
    ]
    assert found[0] == found[1] != found[2]
    assert not found[0][1]
