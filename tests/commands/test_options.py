"""Every option of every command changes what is done, or is refused.

`CASES` has a command line for each option that the parsers have.
"""

import contextlib
import re
import shlex
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from neurosym_jax.__main__ import commands
from neurosym_jax.data.recordings import open_source
from neurosym_jax.evaluation.compare import (
    Settings,
    evaluate_tests,
    load_tests,
    make_plan,
)
from neurosym_jax.interop.parity import Parity
from neurosym_jax.models.disk import load_model
from tests.commands.walk import (
    READ,
    TABLE,
    Case,
    assert_it_matters,
    done,
    options_of,
    write_data,
)
from tests.repository import SMALL

CORE = [
    name for name, module in commands().items() if module.startswith("neurosym_jax.")
]
C, LENGTHS = "neurosym_jax.commands", "--obs-len 4 --pred-len 4"
OF_READING = {
    "train": "--train-on {d}/a/%s --validate-on {d}/b/%s --obs-len 4 --pred-len 4",
    "evaluate": "--data {d}/a/%s --no-figures",
    "inspect": "{d}/a/%s",
    "symbols": "{d}/a/%s --forecast --model sgan_zara1_8",
    "animate": "{d}/a/%s",
}
ANIMATION = "neurosym_jax.plotting"
PARITY = "--torch-module m.py:M --checkpoint c.pt"
BASE = {
    command: line.replace("%s", "walk.txt") for command, line in OF_READING.items()
} | {
    "sweep": f"--data {{d}}/a {LENGTHS} --seed 0 --dataset walk",
    "compare-weightings": f"quantised --data {{d}}/a {LENGTHS} --dataset walk",
    "report": "sweep",
    "parity": f"{PARITY} --keep kept",
    "convert": f"{SMALL} new",
    "export": "sgan_zara1_8 new",
    "download": "eth-ucy",
    "models": "",
}
ALL = "--data {d}/a --dataset walk"
TWO = f"--data {{d}}/a {LENGTHS}"
NEURO = f"{BASE['train']} --family neurosym"
WALK, N = "{d}/a/walk.txt", "neurosym_zara1_8"
LATEX = f"{BASE['evaluate']} --table latex"
FIGURE = f"{WALK} --figure f.png"
FLOOR = f"{FIGURE} --underlay {{d}}/%s/floor.png {{d}}/%s.h"


def added(arguments: str, base: str = "") -> dict[str, Case]:
    """A case for each option of `arguments`, which is added to `base` or to that of the command."""
    parts = re.split(r" (?=--)", arguments)
    names = [
        "--" + part.split()[0].removeprefix("--").removeprefix("no-") for part in parts
    ]
    return {
        name: (base, f"{base} {part}") if base else part
        for name, part in zip(names, parts)
    }


TRAINING = added(
    "--family anchors --pooling none --obs-len 5 --period 0.5 --recipe sgan --steps 7 --set ema=0.5 "
    "--network encoder_h_dim=16 --out here --log tensorboard"
)
CASES: dict[str, dict[str, Case]] = {
    "train": {
        **TRAINING,
        **added(
            "--pred-len 5 --seed 1 --resume --train-on {d}/a/gap.txt --validate-on {d}/b/gap.txt "
            "--train-also {d}/a/gap.txt --quiet"
        ),
        "--init": (ALL, f"{ALL} --init sgan_zara1_8"),
        "--freeze": "--freeze encoder",
        "--fold": (f"{TWO} --dataset walk", f"{TWO} --dataset walk --fold 2/3"),
        **added("--weighting ones", NEURO),
        "--dataset": (f"{TWO} --dataset walk", f"{TWO} --dataset gap"),
        "--data": (f"{TWO} --dataset walk", f"--data {{d}}/b {LENGTHS} --dataset walk"),
    },
    "sweep": {
        **TRAINING,
        **added(
            "--weighting ones soft --dataset gap --pred-len 4 12 --seed 0 1 --data {d}/b "
            "--train-also {d}/b --jobs 3 --dry-run --freeze encoder --fold 1/3 --quiet"
        ),
        "--init": (ALL, f"{ALL} --init sgan_zara1_8"),
        **{option: text for option, (_, text, *_) in READ.items()},
    },
    "compare-weightings": {
        **TRAINING,
        **added(
            "--against ones soft --seeds 2 --dataset gap --pred-len 12 --data {d}/b "
            "--train-also {d}/b --jobs 3 --dry-run --freeze encoder --fold 1/3 --quiet"
        ),
        "--family": "--family anchors",
        "--pooling": "--pooling neurosym_ros",
        "WEIGHTING": (BASE["compare-weightings"], f"soft {TWO} --dataset walk"),
        **{option: text for option, (_, text, *_) in READ.items()},
    },
    "evaluate": {
        **added(
            "--model sgan_simulations_8 --all --data {d}/b/walk.txt --obs-len 5 --pred-len 5 "
            "--period 0.5 --samples 3 --seed 1 --seeds 2 --protocol joint-metrics --min-agents 1 "
            "--baselines constant_velocity_sampled --metrics crps --symbols --no-collisions "
            "--table csv --json here.json --figures --save-forecasts here.npz --cluster tcp://there"
        ),
        **added("--dataset walk", TWO),
        **added("--test-on walk", TWO),
        **added("--intervals", LATEX),
        **added(
            "--label mine=sgan_simulations_8",
            f"--data {WALK} --model sgan_simulations_8",
        ),
        # Their effects are tested by tests/evaluation/test_forecasts.py.
        "--forecasts": (
            BASE["evaluate"],
            f"{BASE['evaluate']} --forecasts {WALK}",
            "walk.txt: cannot be read as .npz, .csv or .ndjson",
        ),
        "--partial": (
            BASE["evaluate"],
            f"{BASE['evaluate']} --partial",
            "--partial: has no effect without --forecasts",
        ),
        **added("--plots here.png --scene 3 --style talk", f"--data {WALK}"),
        **added("--online", f"--data {WALK}"),
        "--place": (
            BASE["evaluate"],
            f"{BASE['evaluate']} --place here.npz",
            "--place: has no effect without --online",
        ),
    },
    "symbols": {
        "DATA": (WALK, "{d}/b/walk.txt"),
        **added("--dataset walk", "{d}/a"),
        **added("--window 3 --model anchors_eth_12 --samples 3 --seed 3 --out here"),
        **added("--weighting quantised --style talk", WALK),
        **added("--forecast", f"{WALK} --model {N}"),
    },
    "animate": {
        "DATA": (WALK, "{d}/b/walk.txt"),
        **added("--dataset walk", "{d}/a"),
        **added("--window 3 --pictures 2 --pred-len 12 --draws 3 --seed 3 --out a.gif"),
        "--model": "--model sgan_zara1_8",
    },
    "inspect": {
        "PATH": (WALK, "{d}/b/walk.txt"),
        "--figure": "--figure f.png",
        "--underlay": (FLOOR % ("a", "a"), FLOOR % ("a", "b")),
        **added("--style talk", FIGURE),
    },
    "convert": {
        "MODEL": (f"{SMALL} new", "sgan_zara1_8 new"),
        "TO": (f"{SMALL} new", f"{SMALL} new.pt"),
        "--ignore-arg": "--ignore-arg mine",
        "--generator-only": (f"{SMALL} new", f"{SMALL} new --generator-only"),
    },
    "export": {
        "MODEL": ("sgan_zara1_8 new", "anchors_eth_12 new"),
        "TO": ("sgan_zara1_8 new", "sgan_zara1_8 newer"),
        "--samples": "--samples 3",
        "--points": ("sgan_zara1_8 a.onnx", "sgan_zara1_8 a.onnx --points"),
    },
    "download": {
        "COLLECTION": ("eth-ucy", "sgan-checkpoints"),
        **added("--to here --mirror https://there --timeout 3"),
    },
    "models": {"--all": "--all"},
    "parity": {
        "DIRECTORY": ("one", "other"),
        **added(
            "--torch-module m.py:N --checkpoint d.pt --python python9 --seed 1 --keep here"
            " --out here.json"
        ),
        "--tolerance": "--tolerance 0.1",
        # No case of it is kept.
        "--train": (f"{PARITY} --keep kept", f"{PARITY} --train 5"),
    },
    "report": {
        "SWEEP": ("sweep", "other"),
        **added("--against cnd --pred-len 12 --out here.md"),
    },
}
for command, line in OF_READING.items():
    for option, (file, text, *error) in READ.items():
        base = line.replace("%s", file)
        CASES[command][option] = (base, f"{base} {text}", *error)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = write_data(tmp_path_factory.mktemp("data"))
    for seed, name in enumerate("ab"):
        Image.new("L", (3, 3), 99 * seed).save(folder / name / "floor.png")
        np.savetxt(folder / f"{name}.h", (seed + 1) * np.eye(3) + np.eye(3)[::-1] / 9)
    for name, content in FILES.items():
        (folder / name).write_bytes(content)
    return folder


INNER: dict[str, dict[str, Any]] = {
    "train": {
        f"{C}.train.train_run": SimpleNamespace(step=3),
        f"{C}.train._print_errors": None,
        f"{C}.train._tensorboard": lambda: contextlib.nullcontext(print),
    },
    "sweep": {f"{C}.sweep.run_sweep": 0},
    "compare-weightings": {
        f"{C}.sweep.run_sweep": 0,
        f"{C}.compare_weightings.compare_sweep": "",
    },
    "convert": {
        f"{C}.convert.{name}": SimpleNamespace(name="model")
        for name in ("load_model", "model_from_torch", "save_model")
    }
    | {
        f"{C}.convert.read_torch_file": {},
        f"{C}.convert.export_torch_checkpoint": None,
        f"{C}.convert.left_out": [],
    },
    "export": {
        f"{C}.export.load_model": SimpleNamespace(
            name="model",
            forecaster=SimpleNamespace(noise=SimpleNamespace(dim=0), count=int),
        ),
        f"{C}.export.export_model": b"",
        f"{C}.export.export_onnx": b"",
    },
    "download": {f"{C}.download.download": (1, 1)},
    "parity": {
        f"{C}.parity.run_parity": Parity(()),
        f"{C}.parity.run_torch": None,
        f"{C}.parity.compare_training": Parity(()),
        f"{C}.parity.new_folder": lambda: contextlib.nullcontext("kept"),
        f"{C}.parity.read_torch_file": {},
        f"{C}.parity.model_from_torch": SimpleNamespace(assumed=()),
    },
    "report": {f"{C}.report.compare_sweep": ""},
    "models": {f"{C}.models.models_at_hand": []},
}
"""For each command: functions that are recorded and not run, with what they return."""


@pytest.fixture(scope="module")
def inner(data):
    """`INNER`, and functions of the commands that show what is evaluated or forecast."""
    source = open_source(data / "a" / "walk.txt")
    plan = make_plan(
        source, [], baselines=("constant_velocity", "constant_velocity_sampled")
    )
    results = list(evaluate_tests(load_tests(source, plan), Settings(2)))
    figure = {
        "neurosym_jax.plotting.save_figure": Path("figure.png"),
        "neurosym_jax.plotting.use_style": None,
    }
    shipped = [load_model.__globals__["find_model"](n) for n in ("sgan_simulations_8",)]
    return INNER | {
        "evaluate": {
            f"{C}.evaluate.evaluate_tests": lambda: iter(results),
            f"{C}.evaluate.map_for": contextlib.nullcontext,
            f"{C}.evaluate.shipped_models": shipped,
            "neurosym_jax.evaluation.saved_forecasts.save_forecasts": [Path("f.npz")],
            "neurosym_jax.plotting.evaluation.draw_figures": [Path("f.png")],
            "neurosym_jax.plotting.use_style": None,
        },
        "symbols": {
            f"{C}.symbols.predict_distribution": np.zeros((2, 5, 8, 2)),
            f"{C}.symbols.forecast_rows": [],
            **figure,
        },
        "animate": {
            f"{C}.animate.predict_distribution": np.zeros((2, 5, 8, 2)),
            f"{ANIMATION}.plot_animation": None,
            f"{ANIMATION}.save_animation": Path("a.gif"),
        },
        "inspect": figure
        | {
            "neurosym_jax.plotting.plot_tracks": None,
            f"{C}.inspect.predict": lambda: None,
        },
    }


def cases():
    """Every option of every command; those of reading in one, and one of them in all."""
    for command in CORE:
        for option in options_of(command):
            again = option in READ and command != "evaluate" and option != "--unit"
            marks = [pytest.mark.exhaustive] if again else []
            yield pytest.param(command, option, marks=marks)


@pytest.mark.parametrize(("command", "option"), [*cases()])
def test_it_changes_what_is_done(command, option, data, inner, tmp_path, capsys):
    case = CASES[command][option]
    assert_it_matters(
        command, BASE[command], case, inner[command], data, tmp_path, capsys
    )


FILES = {
    "word.txt": b"0 1 2 3\n1 1 2 abc\n",
    "corrupt.pt": b"PK\x03\x04" + bytes(range(256)),
    "thesis": b"my thesis",
    "rows.jsonl": b"my notes",
}
REFUSED = {
    "train --weighting quantised --steps 1": "pooling 'pool_net' has no symbols",
    "train --family neurosym --pooling none": "neurosym: pooling 'none' has no symbols",
    "train --variant encounter": "--variant",
    "train --recipe anchors": "recipe: does not fit sgan, which takes ['ours', 'sgan']",
    "train --train-on a --validate-on b --dataset c": "--dataset: has no effect with --train-on",
    "train --validate-on a": "--validate-on: has no effect without --train-on",
    "train --data {d}/a/walk.txt --dataset walk": "walk: the only recording",
    "train --set ema=0.5 ema=0.9": "set ema=0.9: ema is given twice",
    "train --set ema=0.5 --set rotate=0": "--set: is given twice; give it once",
    "evaluate --test-on=a --test_on b": "--test-on: is given twice",
    "train --freeze": "--freeze: its value is missing",
    "evaluate --model --samples 3": "--model: its value is missing",
    "train --set learning_rate=0.1,0.01": "learning_rate must be a finite number",
    "sweep --set ema=0.5 ema=0.9": "set ema=0.9: ema is given twice",
    "train --init absent": "absent: no such model",
    "train --init sgan_zara1_8 --family anchors": "--family: has no effect with --init, which",
    "train --init sgan_zara1_8 --pred-len 12": "--pred-len 12: the model sgan_zara1_8 has 8",
    "train --init sgan_zara1_8 --period 0.2": "--period 0.2: the model sgan_zara1_8 has 0.4",
    "train --init sgan_zara1_8 --freeze own": "freeze: no module 'own' in context_mlp, ",
    "train --data {d}/a --dataset walk --fold 5": "fold: K/N, such as 1/5 for the first of five",
    "train --fold 1/5": "fold 1/5: has no effect where validation is given",
    "train --steps 0": "steps must be at least 1 without an initial model",
    "train --data {d}/a": "--dataset is needed",
    "train --dataset general": "general is for models of real people",
    "train --fps 25": "--fps: has no effect on simulations",
    "symbols --forecast --style talk": "--style: has no effect with --forecast",
    "evaluate --no-figures --scene 3": "--scene: has no effect with --no-figures",
    "evaluate --data {d}/a/walk.txt --scene 59": "--scene must lie in [0, 5",
    "evaluate --no-figures --style talk": "--style: has no effect with --no-figures",
    "train absent.yaml": "absent.yaml: cannot be read: No such file or directory",
    "train 'stepps: 3'": "unknown option 'stepps': did you mean --steps?",
    "train 'steps: 3\nsteps: 4'": "the option 'steps' stands twice",
    "train 'steps: [3'": "cannot be read as a file of options: ",
    "train '- steps'": "must have a line `option: value` for each option",
    "train 'resume: yes'": "resume: must be true or false, not yes",
    "evaluate 'figures: false\nplots: a.png'": "--plots: has no effect with --no-figures",
    "sweep 'seeds: [0, 1]'": "unknown option 'seeds': did you mean --seed?",
    "sweep --keep robot --dry-run": "--keep: has no effect on simulations",
    "sweep --resume": "--resume",
    "sweep --train-on a --validate-on b": "--train-on",
    "sweep --seed": "--seed: at least one is needed",
    "sweep --jobs 0": "--jobs must be at least 1",
    "sweep --pooling lstm": "unknown pooling 'lstm'",
    "sweep --family sgan --pooling none as_described": "pooling=as_described makes it 'neurosym'",
    "sweep --dataset moon": "unknown dataset 'moon': there are all-forward, cross-path",
    "sweep --set emma=1": "set emma=1",
    "sweep --network emma=1": "config emma=1",
    "sweep --weighting quantised quantised,speed=0.125": "two runs of the sweep have",
    "report nothing_here": "`neurosym sweep --out nothing_here` makes one",
    "evaluate {d}/nothing.csv": "nothing.csv",
    "sweep --recipe anchors": "recipe: does not fit sgan, which takes ['ours', 'sgan']",
    "evaluate --max-gap 2": "--max-gap: has no effect on simulations",
    "evaluate --all --model a": "--model: has no effect with --all",
    "evaluate --no-figures --plots a.png": "--plots: has no effect with --no-figures",
    "evaluate --table csv --intervals": "--intervals: has no effect without --table latex",
    "evaluate --data absent": "absent: no such file or folder",
    "evaluate --data recommended": "recommended: is a model, not a recording: `neurosym",
    "evaluate --data eth-ucy": "no such file or folder: `neurosym download eth-ucy` fetches",
    "evaluate zara1 --data {d}/a": "zara1: --data names a recording, too: name one of them",
    "evaluate --data {d}/word.txt": "word.txt: row 2: y is not a number: 'abc'",
    "evaluate --data {d}/a --dataset zara9": "unknown dataset 'zara9'",
    "evaluate --data {d}/a --pred-len 999": "no 1007 consecutive steps",
    "evaluate --model absent.pt": "absent.pt: no such model (`neurosym models --all`",
    "evaluate --dat a": "evaluate has no option --dat: did you mean --data? (",
    "evaluate --models a": "no option --models: did you mean --model? (",
    "symbols a --pred-len 4": "neurosym symbols has no option --pred-len (",
    "evaluate --seed abc": "--seed: 'abc' is not a whole number (neurosym evaluate --help)",
    "evaluate --max-gap x": "--max-gap: 'x' is not a number (",
    "evaluate --data": "--data: its value is missing (neurosym evaluate --help)",
    "evaluate --table html": "--table: 'html' is none of 'text', 'csv', 'markdown', 'latex' (",
    "evaluate --intervals yes": "not understood: yes (neurosym evaluate --help)",
    "convert a": "missing: PATH: The new folder, or a new .pt file, which torch writes (",
    "export recommended": "missing: PATH: The new file. ",
    "evaluate --model recommended --pred-len 4": "forecasts 8 or 12 steps, not 4: neurosym train",
    "evaluate --model recomended": "no such model (did you mean recommended?)",
    "evaluate --model sgan": "sgan: no such model (did you mean sgan_eth_12?)",
    "evaluate --model {d}/corrupt.pt": "corrupt.pt: ",
    "evaluate --model {d}/a": "it has no config.json",
    "evaluate --samples 0": "--samples must be at least 1, not 0",
    "evaluate --seed 4294967296": "--seed must lie in",
    "evaluate --period 0": "the period must be positive, not 0",
    "evaluate --metrics crsp": "unknown metric 'crsp': did you mean 'crps'?",
    "evaluate --baselines nobody": "unknown forecaster 'nobody'",
    "evaluate --baselines": "there is nothing to evaluate",
    "evaluate --save-forecasts f.xlsx": "f.xlsx: forecasts are written as .npz, ",
    "evaluate --json {d}/thesis": "thesis: is not a report of ours, so it is not overwritten",
    "evaluate --json {d}/rows.json": "rows.jsonl: is not a report of ours",
    "evaluate --cluster nowhere://x": "--cluster nowhere://x: no Dask scheduler answers",
    "evaluate --plots {d}/thesis": "thesis/overview.png: cannot be written (Not a directory)",
    "evaluate --plots {d}/thesis/a.png": "thesis/overview.png: cannot be written (Not a directory)",
    "evaluate --data=": "--data: is empty",
    "symbols --unit cm": "--unit: has no effect on simulations",
    "symbols --samples 3": "--samples: has no effect without --forecast",
    "symbols --forecast --weighting cnd": "--weighting: has no effect with --forecast",
    "symbols --forecast --samples 0": "--samples must be at least 1",
    "symbols --forecast": "--forecast needs a --model",
    "symbols --weighting cdn": "unknown weighting 'cdn'",
    "symbols --dataset moon": "unknown data set 'moon'",
    "symbols {d}/a/walk.txt --window 59": "--window must lie in [0, 59), not 59",
    "animate --out a.png": "a.png: an animation's name must end in .gif or .mp4",
    "animate --window 999": "--window must lie in [0, ",
    "animate --draws 0": "--draws must be at least 1",
    "animate --model sgan_zara1_8 --pred-len 12": "--pred-len 12: sgan_zara1_8 has 8",
    "parity cases --seed 1": "--seed: has no effect on stored cases",
    "download thor --mirror a": "--mirror: has no effect on THÖR",
}


@pytest.mark.parametrize("line", REFUSED)
def test_what_cannot_be_done_is_refused_in_a_line(line, data, tmp_path, capsys):
    command, *rest = shlex.split(line.replace("{d}", str(data)))
    if " " in rest[0]:
        (tmp_path / "recipe.yaml").write_text(rest[0])
        rest[0] = str(tmp_path / "recipe.yaml")
    never = {f"{C}.train.train_run": None, f"{C}.sweep.run_sweep": 0}
    (status, _, files, out), error = done(
        [command, *rest], never, tmp_path / "run", capsys
    )
    assert (status, files) == (2, [])
    assert REFUSED[line] in out + error
    (message,) = (text for text in error.splitlines() if not text.startswith("warning"))
    assert (message[:7], out) == ("error: ", "")


def test_a_file_is_a_command_line_that_options_override(data, inner, tmp_path, capsys):
    file = tmp_path / "recipe.yaml"
    file.write_text(
        f"""
        train_on: [{data}/a/tables/odd.csv]
        validate-on: {data}/b/tables/odd.csv
        columns: {{time: t, id: who, x: px, y: py}}
        set: {{ema: 0.5, rotate: 0, max_agents: null}}
        obs_len: 4
        resume: true
        freeze: []
        seed: 7
        """
    )
    read = f"--train-on {data}/a/tables/odd.csv --validate-on {data}/b/tables/odd.csv"
    read += f" --columns {TABLE} --obs-len 4 --resume --set ema=0.5 rotate=0 max_agents=null"
    changed = read.replace("ema=0.5 rotate=0", "rotate=0 ema=0.9 jitter=0.1")
    lines = [
        f"{file} --seed 1",
        f"{read} --seed 1",
        f"{read} --seed 7",
        f"{changed} --seed 7",
    ]
    lines += [
        f"{file} --set ema=0.9 jitter=0.1",
        f"{file} --set=ema=0.9",
        f"{file} --seed 7",
    ]
    outcomes = [
        done(["train", *shlex.split(line)], inner["train"], tmp_path / str(at), capsys)
        for at, line in enumerate(lines)
    ]
    assert outcomes[0] == outcomes[1] != outcomes[2]
    assert not outcomes[0][1]
    # Changes of a recipe add to those of the file.
    assert outcomes[3] == outcomes[4]
    assert len({str(outcome) for outcome in outcomes}) == 4


@pytest.mark.parametrize(
    ("command", "old", "new"),
    [
        ("evaluate", "--checkpoint sgan_simulations_8", "--model sgan_simulations_8"),
        ("evaluate", "--checkpoint=sgan_simulations_8", "--model sgan_simulations_8"),
        ("train", "--model anchor_table", "--family anchor_table"),
        ("train", "'model: anchor_table'", "--family anchor_table"),
        ("sweep", "--model anchor_table sgan", "--family anchor_table sgan"),
    ],
)
def test_an_option_is_known_by_its_old_name(
    command, old, new, data, inner, tmp_path, capsys
):
    outcomes = []
    for at, text in enumerate((old, new)):
        words = shlex.split(text)
        if " " in words[0]:
            (tmp_path / "recipe.yaml").write_text(words[0])
            words = [str(tmp_path / "recipe.yaml")]
        words += shlex.split(BASE[command].replace("{d}", str(data)))
        folder = tmp_path / str(at)
        outcomes.append(done([command, *words], inner[command], folder, capsys))
    assert outcomes[0] == outcomes[1]
    assert not outcomes[0][1]


def test_an_old_name_is_said_on_the_standard_error(tmp_path, capsys):
    line = ["evaluate", "--checkpoint", "absent"]
    (status, _, _, out), error = done(line, {}, tmp_path / "run", capsys)
    assert (status, out) == (2, "")
    note, message = error.splitlines()
    assert note.startswith("warning: --checkpoint is called --model now")
    assert message.startswith("error: absent: no such model")
