"""One file of a plugin adds a family: it trains, resumes, sweeps, is evaluated, saved, exported."""

import json
from pathlib import Path

import jax
import numpy as np
import pytest

import neurosym_jax as nj
from neurosym_jax.__main__ import main
from neurosym_jax.data.tables import ReadOptions
from neurosym_jax.models.forecaster import FORECASTERS, forecaster_of
from neurosym_jax.plugins import load_plugin
from neurosym_jax.training import Recipe
from tests.following import followed
from tests.registrations import forget_plugins, restored_registrations

PLUGIN = str(Path(__file__).with_name("family_plugin.py"))
RECIPE = Recipe(steps=60, batch_scenes=8, validate_every=20, learning_rate=0.01)
FILES = 28
"""Most that run for a training, beside the plugin's own."""
TRAIN = ("--dataset", "cross-path", "--set", "batch_scenes=4", "validate_every=2")


@pytest.fixture(scope="module", autouse=True)
def _plugin():
    load_plugin(PLUGIN)


@pytest.fixture(scope="module")
def windows():
    rng = np.random.default_rng(0)
    walks = []
    for _ in range(24):
        pace = rng.normal(size=(2, 1, 2)) * 0.4
        walks.append(rng.normal(size=(2, 1, 2)) * 3 + pace * np.arange(16)[:, None])
    agents = np.arange(48)
    identity = np.stack([np.zeros(24), np.arange(24)], 1).astype(np.uint32)
    return nj.data.Windows(
        np.concatenate(walks), agents, np.arange(0, 49, 2), identity, 8
    )


def run(*command):
    with pytest.raises(SystemExit) as end:
        main([*command, "--plugin", PLUGIN])
    assert not end.value.code


@pytest.mark.slow
def test_it_learns_and_a_killed_run_ends_with_the_same_bits(windows, tmp_path):
    config, rows = FORECASTERS["attention"].Config(), []
    args = {"config": config, "recipe": RECIPE, "read": ReadOptions(allow=("seen",))}
    with followed() as files:
        uninterrupted = nj.train(
            windows, windows, tmp_path / "whole", on_row=rows.append, **args
        )
    assert len(files) <= FILES, files
    assert rows[-1]["val_ade"] < 0.5 * rows[0]["loss"]
    errors = [row["val_ade"] for row in rows if "val_ade" in row]
    assert errors[-1] < errors[0]

    def kill(row):
        if row["step"] == 40:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        nj.train(windows, windows, tmp_path / "killed", on_row=kill, **args)
    resumed = nj.train(windows, windows, tmp_path / "killed", resume=True, **args)
    jax.tree.map(np.testing.assert_array_equal, uninterrupted.params, resumed.params)

    loaded = nj.load_model(tmp_path / "killed" / "model")
    assert (loaded.family, loaded.seed, loaded.config) == ("attention", 0, config)
    assert loaded.name == "Attention over neighbours"
    observed = windows.position[:2, :8]
    forecast = nj.predict(loaded, observed, samples=3)
    np.testing.assert_allclose(
        nj.forecast(config, loaded.params, observed), forecast, atol=1e-5
    )
    exported = jax.export.deserialize(bytearray(nj.interop.export_model(loaded, 3)))
    np.testing.assert_allclose(
        exported.call(observed.astype("f4"))[0], forecast, atol=1e-4
    )
    assert b"Attention over neighbours" in nj.interop.export_onnx(loaded, 3)
    faster = observed.copy()
    faster[1] = observed[1, -1:] + 1.5 * (observed[1] - observed[1, -1:])
    assert (
        np.abs(nj.predict(loaded, faster, samples=3)[:, 0] - forecast[:, 0]).max()
        > 1e-4
    )


@pytest.mark.slow
def test_commands_know_it(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run("train", "--family", "attention", *TRAIN, "--steps", "4", "--out", "run")
    quick = (
        "--dataset",
        "cross-path",
        "--baselines",
        "constant_velocity",
        "--no-figures",
    )
    run("evaluate", "--model", "run/model", "--samples", "3", *quick)
    assert "Attention over neighbours" in capsys.readouterr().out
    config = json.loads((tmp_path / "run/model/config.json").read_text())
    assert config["forecaster"] == "attention"
    assert "family_plugin.py" in config["plugins"]

    models = ("--family", "attention", "anchor_table")
    sweep = ("sweep", *models, *TRAIN, "--steps", "2", "--seed", "0", "--jobs", "1")
    run(*sweep, "--dry-run")
    for folder in sorted((tmp_path / "runs/sweep").iterdir()):
        # As if nothing were loaded: the run's file names the plugin.
        with restored_registrations():
            forget_plugins()
            del FORECASTERS["attention"]
            with pytest.raises(SystemExit) as end:
                main(["train", str(folder / "recipe.yaml")])
        assert not end.value.code
    run(*sweep)
    names = {path.name for path in (tmp_path / "runs/sweep").iterdir() if path.is_dir()}
    assert names == {f"{model}_cross-path_8_8_seed0" for model in models[1:]}
    assert "Attention over neighbours" in (tmp_path / "runs/sweep/sweep.md").read_text()


def test_what_has_nothing_to_learn_is_refused(windows, tmp_path):
    config = nj.models.ConstantVelocity.Config()
    assert forecaster_of(config).title.startswith("constant velocity")
    with pytest.raises(nj.InputError, match="constant velocity has nothing to train"):
        nj.train(
            windows, windows, tmp_path, config=config, read=ReadOptions(allow=("seen",))
        )
    with pytest.raises(
        nj.InputError, match=r"does not fit attention, which takes \['attention'\]"
    ):
        nj.train(
            windows,
            windows,
            tmp_path,
            config=FORECASTERS["attention"].Config(),
            recipe=nj.AnchorRecipe(),
            read=ReadOptions(allow=("seen",)),
        )
