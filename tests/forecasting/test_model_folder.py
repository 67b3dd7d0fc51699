import dataclasses
import json
import shutil
import subprocess

import jax
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.forecaster import Lengths
from neurosym_jax.forecasting.model import Model
from neurosym_jax.forecasting.model_folder import load_model, save_model
from neurosym_jax.forecasting.parameters import flat_parameters, nested_parameters
from neurosym_jax.models.config import GeneratorConfig


def random_model(config):
    rng = np.random.default_rng(0)
    shapes = Model(config, {}).forecaster.shapes().items()
    params = {name: rng.normal(size=shape).astype(np.float32) for name, shape in shapes}
    return Model(config, nested_parameters(params), "zara1")


MODEL = random_model(GeneratorConfig(pooling="pool_net,hidden_dim=16"))


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("models") / "zara1"
    save_model(folder, MODEL)
    return folder


@pytest.fixture
def copy(saved, tmp_path):
    """A copy of the folder that a test may damage."""
    return shutil.copytree(saved, tmp_path / "copy")


def refusal(folder):
    with pytest.raises(InputError) as caught:
        load_model(folder)
    message = str(caught.value)
    assert "\n" not in message
    assert str(folder) in message
    return message


def test_round_trip(saved):
    loaded = load_model(saved)
    assert (loaded.config, loaded.dataset, loaded.kind) == (MODEL.config, "zara1", "generator")
    jax.tree.map(assert_array_equal, loaded.params, MODEL.params)
    assert {leaf.dtype for leaf in jax.tree.leaves(loaded.params)} == {np.dtype(np.float32)}
    assert {path.name for path in saved.iterdir()} == {
        *("README.md", "config.json", "params.safetensors"),
    }
    assert (saved / "README.md").read_text().startswith("# SGAN, to be tested on zara1\n")
    assert [path.name for path in saved.parent.iterdir()] == ["zara1"]


def test_anybody_can_check_the_digest(saved):
    command = "(tail -n +3 config.json; cat README.md params.safetensors) | sha256sum"
    found = subprocess.run(["sh", "-c", command], cwd=saved, capture_output=True, check=True).stdout
    assert found.split()[0].decode() == json.loads((saved / "config.json").read_text())["sha256"]


def flipped(content, bit):
    damaged = bytearray(content)
    damaged[bit // 8] ^= 1 << bit % 8
    return bytes(damaged)


def test_every_flipped_bit_is_refused(copy, tmp_path):
    """All of a short configuration, some of the parameters: before a parser sees either."""
    save_model(tmp_path / "short", Model(Lengths(), {}, "zara1", "constant_velocity"))
    rng = np.random.default_rng(0)
    config, params = tmp_path / "short" / "config.json", copy / "params.safetensors"
    of_params = rng.choice(8 * params.stat().st_size, 200, replace=False)
    for path, bits in ((config, range(8 * config.stat().st_size)), (params, of_params)):
        content = path.read_bytes()
        for bit in bits:
            path.write_bytes(flipped(content, bit))
            assert "damaged" in refusal(path.parent), (path.name, bit)
        for size in (0, 1, 100, len(content) - 1):
            path.write_bytes(content[:size])
            assert "damaged" in refusal(path.parent), size
        path.write_bytes(content + b" ")
        assert "damaged" in refusal(path.parent)
        path.write_bytes(content)
        assert load_model(path.parent).dataset == "zara1"


@pytest.mark.parametrize("text", ["", "{}", "\x00", "[" * 100_000])
def test_config_that_is_none(copy, text):
    (copy / "config.json").write_text(text)
    assert "damaged" in refusal(copy)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda all: all["config"].update(embedding_dim=8), "describes another network"),
        (lambda all: all["config"].update(noise_dim=99), "noise_dim must lie in"),
        (lambda all: all["config"].update(pooling="mean"), "unknown pooling 'mean'"),
        (lambda all: all["config"].update(obs_len=True), "obs_len must be a whole number"),
        (lambda all: all["config"].update(colour=1), "unknown field 'colour'"),
        (lambda all: all.update(config=[1]), "not a JSON object"),
        (lambda all: all.update(format=True), "format True is not the format 3"),
        (lambda all: all.update(format=2), "format 2 is not the format 3"),
        (lambda all: all.update(seen="A" * 15), "seen is not a fingerprint"),
        (lambda all: all.update(forecaster="nobody"), "unknown forecaster 'nobody'"),
        (lambda all: all.pop("dataset"), "must have the fields"),
    ],
)
def test_wrong_values_under_a_right_digest(copy, sign, change, message):
    sign(copy, change)
    assert message in refusal(copy)


def header(**entries):
    text = json.dumps(entries).encode()
    return len(text).to_bytes(8, "little") + text


@pytest.mark.parametrize(
    ("params", "message"),
    [
        (b"", "cannot be read"),
        (header(), "describes another network"),
        (header(a={"dtype": "F32", "shape": [2**40], "data_offsets": [0, 2**42]}), "cannot be"),
        (header(a={"dtype": "BF16", "shape": [1], "data_offsets": [0, 2]}) + b"00", "numbers"),
        ((2**40).to_bytes(8, "little") + b"{}", "cannot be read"),
    ],
)
def test_parameters_that_promise_what_is_not_there(copy, sign, params, message):
    sign(copy, params=params)
    assert message in refusal(copy)


def test_parameters_that_are_not_finite(copy, sign, tmp_path):
    model = dataclasses.replace(MODEL, params=jax.tree.map(np.array, MODEL.params))
    params = flat_parameters(model.params)
    params["params/encoder/lstm/input_bias"][3] = np.nan
    with pytest.raises(InputError, match="not finite: params/encoder/lstm/input_bias"):
        save_model(tmp_path / "new", model)
    from safetensors.numpy import save

    sign(copy, params=save(params))
    assert "not finite: params/encoder/lstm/input_bias" in refusal(copy)
    assert not (tmp_path / "new").exists()


def test_nothing_is_overwritten(saved, tmp_path):
    with pytest.raises(InputError, match="already there, and nothing is overwritten"):
        save_model(saved, dataclasses.replace(MODEL, dataset=None))
    (tmp_path / "file").write_text("mine")
    with pytest.raises(InputError, match="already there"):
        save_model(tmp_path / "file", MODEL)
    with pytest.raises(InputError, match="cannot be written"):
        save_model(tmp_path / "file" / "new", MODEL)


def test_what_is_no_model(tmp_path):
    assert "no such checkpoint" in refusal(tmp_path / "absent")
    assert "it has no config.json" in refusal(tmp_path)
    (tmp_path / "noise.pt").write_bytes(bytes(range(256)) * 9)
    refusal(tmp_path / "noise.pt")
    (tmp_path / "empty.pt").write_bytes(b"")
    refusal(tmp_path / "empty.pt")


@pytest.mark.parametrize(
    "params", [(1, 2), {"a": [1.0]}, {"a/b": np.zeros(1)}, {"a": {}}, {1: np.zeros(1)}, {"a": "b"}]
)
def test_parameters_that_would_not_come_back(params):
    with pytest.raises(InputError, match="parameter"):
        flat_parameters(params)
