"""Every argument of every public function changes the result, or is refused.

A function that is called by others can lose an argument on the way without failing.
Each argument of the functions below has a value here that is not its default; an
argument without one, and a public function that is neither here nor in `ELSEWHERE`,
fails.
"""

import dataclasses
import inspect
from pathlib import Path

import jax
import numpy as np
import polars as pl
import pytest

import neurosym_jax as nj
from neurosym_jax.data.tables import ReadOptions
from neurosym_jax.models.forecast import Model
from neurosym_jax.models.forecaster import FORECASTERS, Lengths
from neurosym_jax.models.sgan.network import GeneratorConfig
from tests.networks import random_model

ELSEWHERE = {
    "load_place": "what was saved: tests/models/place/test_place.py",
    "predict_batches": "streams: tests/models/test_functional.py",
    "load_model": "what is shipped: tests/models/test_model_places.py",
    "train": "takes minutes: tests/training/test_loop.py",
}
"""Public functions of the top level that have no row here, and where they are tested."""

RNG = np.random.default_rng(0)
WALKS = RNG.normal(0, 0.3, (7, 40, 2)).cumsum(1) + RNG.uniform(-2, 2, (7, 1, 2))
OBSERVED = WALKS[:3, :4].copy()
OBSERVED[0, 2] += 9.0  # A tracking error, for `repair`.
NETWORK = GeneratorConfig(
    obs_len=4, pred_len=3, embedding_dim=4, encoder_h_dim=8, decoder_h_dim=8, mlp_dim=8,
    pooling="as_described,hidden_dim=8", noise_dim=2,
)  # fmt: skip
MODEL = random_model(NETWORK, std=0.5)
OTHER = random_model(dataclasses.replace(NETWORK, noise_type="uniform"), std=0.4)
SAMPLED = Model(Lengths(4, 3), {}, None, "constant_velocity_sampled")
SLOWER = Model(Lengths(4, 3, period=0.8), {}, None, "constant_velocity_sampled")


def rows(walks, step=0.4, label="person"):
    """A table of walks [N, T, 2]: the last walks in a vehicle, the first misses a row."""
    person, frame = np.divmod(
        np.arange(walks.shape[0] * walks.shape[1]), walks.shape[1]
    )
    x, y = walks.reshape(-1, 2).T
    table = pl.DataFrame(
        {"time": frame * step, "id": person, "x": x, "y": y, "z": y[::-1]}
    )
    kinds = pl.Series("label", np.where(person == len(walks) - 1, "car", label))
    return table.with_columns(kinds).filter(~((person == 0) & (frame == 20)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Recordings `walk.csv` and `other.csv`, in which all but two people leave early."""
    folder = tmp_path_factory.mktemp("recordings")
    table = rows(WALKS)
    stays = pl.col("id").is_in([0, 1, 6]) | (pl.col("time") < 8)
    table.filter(stays).write_csv(folder / "walk.csv")
    rows(WALKS[:, ::-1]).write_csv(folder / "other.csv")
    return folder


READING = {
    "format": "trajnet",
    "columns": ("time=time", "id=id", "x=x", "y=z"),
    "unit": "cm",
    "time_unit": "ms",
    "keep": ("person", "car"),
    "fps": 5.0,
    "max_gap": 0.5,
    "homography": "absent.txt",
    "flip_y": True,
}
"""A value for each field of `ReadOptions` but three, which have tests of their own."""

NOISE, ALPHA = RNG.normal(size=(2, 2)), RNG.uniform(size=(3, 3, 4))
CALLS = {
    "predict": (
        lambda folder: {"model": MODEL, "observed": OBSERVED, "samples": 3},
        lambda folder: {
            "model": OTHER, "observed": OBSERVED[::-1], "samples": 4,
            "seed": 1, "recording": "a", "frame": 5, "repair": True,
        },
    ),
    "predict_distribution": (
        lambda folder: {"model": MODEL, "observed": OBSERVED, "draws": 3},
        lambda folder: {
            "model": OTHER, "observed": OBSERVED[::-1], "draws": 4,
            "seed": 1, "recording": "a", "frame": 5, "repair": True,
        },
    ),
    "predict_scenes": (
        lambda folder: {"model": MODEL, "observed": [OBSERVED, OBSERVED[:2]], "samples": 3},
        lambda folder: {
            "model": OTHER, "observed": [OBSERVED], "samples": 4,
            "seed": 1, "recording": "a", "frames": [5, 1], "repair": True,
            "valid": [np.array([True, False, True]), np.array([True, True])],
        },
    ),
    "forecast": (
        lambda folder: {
            "config": NETWORK, "params": MODEL.params, "observed": OBSERVED, "noise": NOISE,
        },
        lambda folder: {
            "config": dataclasses.replace(NETWORK, pred_len=4), "params": OTHER.params,
            "observed": OBSERVED[::-1], "noise": -NOISE, "alpha": ALPHA,
            "valid": np.array([True, True, False]),
        },
    ),
    "make_scene": (
        lambda folder: {"observed": OBSERVED},
        lambda folder: {
            "observed": OBSERVED[::-1], "future": OBSERVED, "recording": "a", "frame": 5,
            "extras": {"group": np.arange(3)}, "period": 0.5,
        },
    ),
    "windows_from": (
        lambda folder: {"data": folder / "walk.csv", "obs_len": 4, "pred_len": 3},
        lambda folder: {
            "data": folder / "other.csv", "obs_len": 5, "pred_len": 4, "period": 0.8,
            "read": ReadOptions(unit="cm"), "skip": 2, "min_agents": 4,
        },
    ),
    "evaluate": (
        lambda folder: {"models": SAMPLED, "recordings": folder / "walk.csv", "baselines": ()},
        lambda folder: {
            "models": [SAMPLED, SLOWER], "recordings": folder / "other.csv", "samples": 4,
            "seed": 1, "min_agents": 4, "metrics": ["joint_fde"],
            "baselines": ["constant_velocity"], "forecasts": folder / "walk.csv", "obs_len": 5,
            "pred_len": 5, "period": 0.8, "partial": True, **READING,
        },
    ),
    "save_model": (
        lambda folder: {"folder": folder / "saved", "model": SAMPLED},
        lambda folder: {
            "folder": folder / "elsewhere", "model": MODEL, "card": "# A card of one's own",
        },
    ),
}  # fmt: skip
"""Arguments by name of a call of each function, and another value of every argument."""


def content(result, folder):
    """What a result holds, as something that can be compared."""
    if result is None:  # what was written, if the function returns nothing
        files = sorted(
            path for path in folder.glob("*/*") if path.parent.name != "before"
        )
        return [(str(path), path.read_bytes()) for path in files]
    if isinstance(result, pl.DataFrame):
        return result.drop(pl.selectors.contains("second", "latency")).to_dict(
            as_series=False
        )
    if dataclasses.is_dataclass(result):
        result = {
            field.name: getattr(result, field.name)
            for field in dataclasses.fields(result)
        }
    leaves = jax.tree_util.tree_leaves_with_path(result)
    return [(str(path), str(np.asarray(leaf).tolist())) for path, leaf in leaves]


def outcome(function, arguments, folder):
    """The content of what a call returns, or how it is refused."""
    for path in folder.glob("*/*"):
        path.unlink()
    for path in folder.glob("*/"):
        path.rmdir()
    try:
        return content(function(**arguments), folder)
    except nj.InputError as error:
        return str(error)


def names(function):
    parameters = inspect.signature(function).parameters.values()
    return {
        parameter.name
        for parameter in parameters
        if parameter.kind is not parameter.VAR_KEYWORD
    }


def test_every_public_function_and_every_argument_has_a_row():
    exported = {name: getattr(nj, name) for name in nj.__all__}
    functions = {
        name
        for name, value in exported.items()
        if inspect.isfunction(value) and not name.startswith("register_")
    }
    assert functions == set(CALLS) | set(ELSEWHERE) | {"predict_representatives"}
    for name, (_, others) in CALLS.items():
        # `replace` changes nothing in an empty folder; its test is below. That of `place`
        # is tests/models/place/test_place.py.
        left = names(exported[name]) - {"replace", "place"}
        assert left <= set(others(Path())), name
    assert names(nj.predict_representatives) == names(nj.predict)
    fields = {field.name for field in dataclasses.fields(ReadOptions)}
    assert fields == {*READING, "allow", "eth_stride", "missing"}


@pytest.mark.parametrize("name", [*CALLS, "predict_representatives"])
def test_each_argument_changes_the_result_or_is_refused(folder, name):
    function = getattr(nj, name)
    if name == "forecast":
        function = jax.jit(nj.forecast, static_argnames="config")
    usual, others = CALLS["predict" if name == "predict_representatives" else name]
    base = usual(folder)
    before = outcome(function, base, folder)
    assert not isinstance(before, str), before
    assert outcome(function, base, folder) == before
    without = [
        argument
        for argument, value in others(folder).items()
        if outcome(function, {**base, argument: value}, folder) == before
    ]
    assert without == []


@pytest.mark.parametrize("field", [*READING])
def test_each_way_of_reading_changes_windows_or_is_refused(folder, field):
    usual = {"data": folder / "walk.csv", "obs_len": 4, "pred_len": 3}
    before = outcome(nj.windows_from, usual, folder)
    read = ReadOptions(**{field: READING[field]})
    assert outcome(nj.windows_from, {**usual, "read": read}, folder) != before


def test_the_frames_of_eth_are_counted_as_the_caller_says(tmp_path):
    table = rows(WALKS[:, :20], step=10).select("time", "id", "x", "y")
    table.write_csv(tmp_path / "biwi_eth.txt", separator="\t", include_header=False)
    usual = {"data": tmp_path / "biwi_eth.txt", "obs_len": 4, "pred_len": 3}
    before = outcome(nj.windows_from, usual, tmp_path)
    read = ReadOptions(eth_stride=6.0)
    assert outcome(nj.windows_from, {**usual, "read": read}, tmp_path) != before


def test_what_no_person_does_is_refused_unless_the_caller_says_so(folder):
    rows(60 * WALKS).write_csv(folder / "fast.csv")
    usual = {"models": SAMPLED, "recordings": folder / "fast.csv", "baselines": ()}
    assert "fast.csv" in outcome(nj.evaluate, usual, folder)
    with pytest.warns(nj.errors.InputWarning):
        assert outcome(nj.evaluate, {**usual, "allow": ["fast"]}, folder)["model"]


def test_a_model_is_replaced_only_where_the_caller_says_so(tmp_path):
    nj.save_model(tmp_path / "model", MODEL)
    with pytest.raises(nj.InputError, match="already"):
        nj.save_model(tmp_path / "model", OTHER)
    assert nj.load_model(tmp_path / "model").config == MODEL.config
    nj.save_model(tmp_path / "model", OTHER, replace=True)
    assert nj.load_model(tmp_path / "model").config == OTHER.config


@pytest.mark.parametrize("kind", FORECASTERS)
def test_each_field_of_a_configuration_comes_back_from_its_file(tmp_path, kind):
    """With values that are no default, of every network that ships."""
    config = FORECASTERS[kind].Config
    changes = {
        field.name: field.default + 1
        for field in dataclasses.fields(config)
        if type(field.default) is int and field.name not in ("noise_dim", "seed")
    }
    model = random_model(config(**{**changes, "period": 0.5}), "somewhere", std=0.5)
    model = dataclasses.replace(model, params=model.params or {}, family=kind)
    nj.save_model(tmp_path / "model", model)
    loaded = nj.load_model(tmp_path / "model")
    assert loaded.config == model.config
    assert (loaded.family, loaded.dataset) == (kind, "somewhere")
