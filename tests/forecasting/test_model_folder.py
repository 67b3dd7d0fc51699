import dataclasses
import json

import jax
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from neurosym_jax.config import GeneratorConfig
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.model import Model
from neurosym_jax.forecasting.model_folder import load_model, save_model, shipped_models
from neurosym_jax.models import Generator
from neurosym_jax.scene import make_scene
from neurosym_jax.training.arrays import digest


def random_model(config):
    scene = make_scene(np.zeros((1, config.obs_len, 2)))
    alpha = np.zeros((*((1,) if config.pooling == "neurosym_ijcnn" else (1, 1)), config.obs_len))
    noise = np.zeros(config.noise_dim)
    shapes = jax.eval_shape(Generator(config).init, jax.random.key(0), scene, noise, alpha)
    rng = np.random.default_rng(0)
    params = jax.tree.map(lambda leaf: rng.normal(size=leaf.shape).astype(np.float32), shapes)
    return Model(config, params, "zara1")


MODEL = random_model(GeneratorConfig(pool_hidden_dim=16))


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("models") / "zara1"
    save_model(folder, MODEL)
    return folder


@pytest.fixture
def copy(saved, tmp_path):
    """A copy of the folder that a test may damage."""
    for path in sorted(saved.rglob("*")):
        target = tmp_path / "copy" / path.relative_to(saved)
        target.parent.mkdir(parents=True, exist_ok=True)
        if path.is_file():
            target.write_bytes(path.read_bytes())
        else:
            target.mkdir(exist_ok=True)
    return tmp_path / "copy"


def refusal(folder):
    with pytest.raises(InputError) as caught:
        load_model(folder)
    message = str(caught.value)
    assert "\n" not in message
    assert str(folder) in message
    return message


def test_round_trip(saved):
    loaded = load_model(saved)
    assert loaded.config == MODEL.config
    assert loaded.dataset == "zara1"
    jax.tree.map(assert_array_equal, loaded.params, MODEL.params)
    assert digest(loaded.params) == digest(MODEL.params)
    assert {leaf.dtype for leaf in jax.tree.leaves(loaded.params)} == {np.dtype(np.float32)}
    assert shipped_models(saved.parent) == [saved]
    assert shipped_models(saved.parent / "absent") == []


@pytest.mark.parametrize("pooling", ["as_described", "neurosym_ros", "neurosym_ijcnn"])
def test_round_trip_of_neurosym(tmp_path, pooling):
    model = random_model(GeneratorConfig(pooling=pooling, pool_hidden_dim=8))
    save_model(tmp_path / "new", model)
    assert load_model(tmp_path / "new").config == model.config


def test_a_copy_is_as_good(copy):
    assert load_model(copy).dataset == "zara1"


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_any_damaged_file_of_the_parameters(copy):
    """Every file that matters: flipped in the middle, cut short, or gone."""
    noticed = 0
    for path in sorted(path for path in (copy / "params").rglob("*") if path.is_file()):
        content = path.read_bytes()
        if not content:
            continue
        middle = len(content) // 2
        flipped = content[:middle] + bytes([content[middle] ^ 4]) + content[middle + 1 :]
        for damaged in (flipped, content[:middle]):
            path.write_bytes(damaged)
            try:
                loaded = load_model(copy)
            except InputError:
                noticed += 1
                refusal(copy)
            else:  # A file of records about the save, not of the parameters.
                assert digest(loaded.params) == digest(MODEL.params)
        path.write_bytes(content)
    assert noticed >= 2
    assert load_model(copy).dataset == "zara1"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not a model's configuration"),
        ("[1]", "must have exactly the fields"),
        ("{}", "must have exactly the fields"),
        ("\x00", "not a model's configuration"),
    ],
)
def test_config_that_is_none(copy, text, message):
    (copy / "config.json").write_text(text)
    assert message in refusal(copy)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"embedding_dim": 8}, "describes another network"),
        ({"pooling": "none"}, "describes another network"),
        ({"encoder_h_dim": 16}, "describes another network"),
        ({"noise_dim": 99}, "noise_dim must lie in"),
        ({"pooling": "mean"}, "unknown pooling 'mean'"),
        ({"colour": 1}, "unknown field 'colour'"),
    ],
)
def test_config_of_another_network(copy, change, message):
    config = json.loads((copy / "config.json").read_text())
    config["generator"] |= change
    (copy / "config.json").write_text(json.dumps(config))
    assert message in refusal(copy)


def test_other_formats_and_digests(copy):
    path = copy / "config.json"
    config = json.loads(path.read_text())
    path.write_text(json.dumps({**config, "format": 2}))
    assert "format 2 is not the format 1" in refusal(copy)
    path.write_text(json.dumps({**config, "sha256": "0" * 64}))
    assert "damaged" in refusal(copy)
    path.write_text(json.dumps({**config, "generator": [1]}))
    assert "not a model's configuration" in refusal(copy)


def test_nothing_is_overwritten(saved, tmp_path):
    with pytest.raises(InputError, match="already there, and nothing is overwritten"):
        save_model(saved, dataclasses.replace(MODEL, dataset=None))
    (tmp_path / "file").write_text("mine")
    with pytest.raises(InputError, match="already there"):
        save_model(tmp_path / "file", MODEL)


def test_what_is_no_model(tmp_path):
    assert "no such checkpoint" in refusal(tmp_path / "absent")
    assert "it has no config.json" in refusal(tmp_path)
    (tmp_path / "noise.pt").write_bytes(bytes(range(256)) * 9)
    refusal(tmp_path / "noise.pt")
    (tmp_path / "empty.pt").write_bytes(b"")
    refusal(tmp_path / "empty.pt")


def test_digest_sees_names_shapes_types_and_bits():
    base = {"a": np.arange(4.0), "b": np.zeros(2)}
    others = [
        {"a": np.arange(4.0), "c": np.zeros(2)},
        {"a": np.arange(4.0).reshape(2, 2), "b": np.zeros(2)},
        {"a": np.arange(4), "b": np.zeros(2)},
        {"a": np.arange(4.0), "b": np.array([0.0, -0.0])},
    ]
    assert digest(dict(reversed(base.items()))) == digest(base)
    assert len({digest(tree) for tree in [base, *others]}) == 5
