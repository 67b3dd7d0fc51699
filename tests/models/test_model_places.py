import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest

import neurosym_jax as nj
from neurosym_jax import load_model
from neurosym_jax.commands.models import run
from neurosym_jax.errors import InputError, InputWarning
from neurosym_jax.models import disk
from neurosym_jax.models.anchors.network import AnchorTableConfig
from neurosym_jax.models.disk import (
    RECOMMENDED,
    find_model,
    find_models,
    save_model,
    shipped_models,
    spoken_name,
)
from tests.networks import random_model
from tests.repository import ROOT

NAME = "neurosym_zara1_8"
SHIPPED = ROOT / "checkpoints"


@pytest.fixture
def downloads(tmp_path, monkeypatch):
    """An empty working folder, and where downloads go."""
    monkeypatch.setenv("NEUROSYM_DATA", str(tmp_path / "data"))
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path / "data" / "sgan-checkpoints"


def test_a_path_goes_before_a_name(downloads):
    for name in (NAME, RECOMMENDED):
        shutil.copytree(SHIPPED / "sgan_eth_8", name, dirs_exist_ok=True)
        with pytest.warns(
            InputWarning, match=f"{name}: the one in this folder, not the model"
        ):
            assert find_model(name) == Path(name)
        with pytest.warns(InputWarning):
            assert load_model(name).name == "SGAN"
        shutil.rmtree(name)
    Path(RECOMMENDED).mkdir()  # Without a model in it, as of results.
    assert find_model(RECOMMENDED) == SHIPPED / "anchors_general_8"
    assert find_models([RECOMMENDED]) == ["anchors_general_8"]
    assert find_model(NAME) == SHIPPED / NAME
    assert find_model("nowhere") == Path("nowhere")
    for nowhere in ("nowhere", "x" * 300, "a\0b"):
        assert find_models([nowhere]) == [nowhere]
        with pytest.raises(InputError, match="neurosym models"):
            load_model(nowhere)


def test_folders_of_several(downloads):
    with pytest.raises(InputError, match="sgan-20vp: not here yet: `neurosym download"):
        find_models(["sgan-20vp"])
    (downloads / "sgan-p-models").mkdir(parents=True)
    for name in ("zara1_8_model.pt", "eth_12_model.pt", "notes.txt"):
        (downloads / "sgan-p-models" / name).write_text("")
    paths = [
        str(downloads / "sgan-p-models" / f"{name}_model.pt")
        for name in ("eth_12", "zara1_8")
    ]
    for name in ("sgan-20vp", "sgan-p-models", downloads / "sgan-p-models"):
        assert find_models([name]) == paths
    assert find_models([NAME, "sgan-20vp"]) == [NAME, *paths]
    assert len(find_models([SHIPPED])) == len(shipped_models())


def test_shipped_and_downloaded_models_are_listed(downloads, shared, capsys):
    shutil.copytree(
        shared / "checkpoints" / "sgan-p-models", downloads / "sgan-p-models"
    )
    run(all=True)
    first, _, head, *lines = capsys.readouterr().out.splitlines()
    assert first.startswith("recommended: take this one")
    titles = "name forecaster steps period neighbours test on learned from where"
    assert head.split() == titles.split()
    assert len(lines) == len(shipped_models()) + 10
    line = next(line for line in lines if line.startswith(f"{NAME} "))
    about = [NAME, "NeuroSyM,", "cnd", "8+8", "0.4", "s", "99", "%", "zara1", "ETH/UCY"]
    assert line.split() == [*about, "(unstated)", str(SHIPPED)]
    for line in lines[-10:]:
        load_model(line.split()[0])


@pytest.fixture
def shipped(tmp_path, monkeypatch):
    """Three anchor tables as the only models that ship, two of them by the name of anchors."""
    monkeypatch.setattr(disk, "_shipped_folder", lambda: tmp_path)
    monkeypatch.chdir(tmp_path / "..")
    for name in ("anchors_zara1_12", "anchors_general_8", "anchor_table_zara1_12"):
        *_, dataset, pred_len = name.split("_")
        model = random_model(
            AnchorTableConfig(pred_len=int(pred_len)), dataset, std=0.1
        )
        save_model(
            tmp_path / name, dataclasses.replace(model, data={"ETH/UCY": "unstated"})
        )
    return tmp_path


def test_recommended_models_did_not_learn_from_the_data_set(shipped):
    assert find_model("recommended", "zara1", 12) == shipped / "anchors_zara1_12"
    assert find_model("recommended", "my_lobby") == shipped / "anchors_general_8"
    loaded = load_model("recommended", dataset="zara1", pred_len=12)
    assert (loaded.dataset, loaded.config.pred_len) == ("zara1", 12)
    assert loaded.data == {"ETH/UCY": "unstated"}
    assert load_model("recommended").dataset == "general"
    assert find_models(["recommended", "x"], ["zara1", "eth"], 12) == [
        *("anchors_zara1_12", "anchors_eth_12", "x")
    ]
    with pytest.raises(InputError, match="anchors_eth_12: no such model"):
        load_model("recommended", dataset="eth", pred_len=12)
    with pytest.raises(InputError, match="recommended forecasts 8 or 12 steps, not 4:"):
        load_model("recommended", pred_len=4)


def test_recommended_is_called_what_was_typed():
    place = find_model("recommended", "zara1", 12)
    model = load_model(place)
    assert spoken_name("recommended", place, model) == "recommended (anchors_zara1_12)"
    assert spoken_name("anchors_zara1_12", place, model) == "anchors"


def test_a_model_is_called_recommended_in_tables_if_it_was_asked_for_so(tmp_path):
    """Commands said `recommended` and Python `anchors`, of the same model."""
    model = load_model("recommended")
    walk = np.arange(24)[:, None] * [0.5, 0.0]
    people = [(step, who) for step in range(24) for who in (0, 1)]
    rows = [f"{0.4 * t:.1f},{who},{walk[t, 0]},{who}" for t, who in people]
    (tmp_path / "a.csv").write_text("\n".join(["time,id,x,y", *rows]))
    table = nj.evaluate(model, tmp_path / "a.csv", samples=2, baselines=())
    assert table["model"].to_list() == ["recommended"]
    assert load_model("anchors_general_8").name == "anchors"
    save_model(tmp_path / "copy", model)
    assert load_model(tmp_path / "copy").name == "anchors"
    assert (tmp_path / "copy/README.md").read_text().count("recommended") == 0
