import dataclasses
import hashlib
import json
import re
import shutil
import subprocess

import jax
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from neurosym_jax.errors import InputError, InputWarning
from neurosym_jax.models.disk import load_model, save_model
from neurosym_jax.models.forecast import Model
from neurosym_jax.models.forecaster import Lengths, flat_parameters, refuse_misfit
from neurosym_jax.models.sgan.network import GeneratorConfig
from tests.networks import random_model

MODEL = random_model(GeneratorConfig(pooling="pool_net,hidden_dim=16"), "zara1")


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("models") / "zara1"
    save_model(folder, MODEL)
    return folder


@pytest.fixture
def copy(saved, tmp_path):
    """A copy of the folder that a test may damage."""
    return shutil.copytree(saved, tmp_path / "copy")


def sign(folder, change=lambda config: None, params=None):
    """Change a model and its digest, as a person can who knows how that is made."""
    config = json.loads((folder / "config.json").read_text())
    del config["sha256"]
    change(config)
    if params is not None:
        (folder / "params.safetensors").write_bytes(params)
    rest = json.dumps(config).removeprefix("{").encode()
    others = [
        (folder / name).read_bytes() for name in ("README.md", "params.safetensors")
    ]
    sha256 = hashlib.sha256(b"".join([rest, *others])).hexdigest().encode()
    (folder / "config.json").write_bytes(b'{\n  "sha256": "' + sha256 + b'",\n' + rest)


def refusal(folder):
    with pytest.raises(InputError) as caught:
        load_model(folder)
    message = str(caught.value)
    assert "\n" not in message
    assert str(folder) in message
    return message


def test_round_trip(saved):
    loaded = load_model(saved)
    assert (loaded.config, loaded.dataset, loaded.family) == (
        MODEL.config,
        "zara1",
        "generator",
    )
    jax.tree.map(assert_array_equal, loaded.params, MODEL.params)
    assert {leaf.dtype for leaf in jax.tree.leaves(loaded.params)} == {
        np.dtype(np.float32)
    }
    files = {"README.md", "config.json", "params.safetensors"}
    assert {path.name for path in saved.iterdir()} == files
    assert (
        "\n---\n\n# SGAN, to be tested on zara1\n" in (saved / "README.md").read_text()
    )
    assert [path.name for path in saved.parent.iterdir()] == ["zara1"]
    # The digest can be checked without the package.
    command = "(tail -n +3 config.json; cat README.md params.safetensors) | sha256sum"
    output = subprocess.run(
        command, shell=True, cwd=saved, capture_output=True, check=True
    ).stdout
    assert (
        output.split()[0].decode()
        == json.loads((saved / "config.json").read_text())["sha256"]
    )


def flipped(content, bit):
    damaged = bytearray(content)
    damaged[bit // 8] ^= 1 << bit % 8
    return bytes(damaged)


def test_every_flipped_bit_is_refused(copy, tmp_path):
    """All of a short configuration, some of the parameters: before a parser sees either."""
    save_model(tmp_path / "short", Model(Lengths(), {}, "zara1", "constant_velocity"))
    rng = np.random.default_rng(0)
    config, params = tmp_path / "short" / "config.json", copy / "params.safetensors"
    flips = rng.choice(8 * params.stat().st_size, 200, replace=False)
    for path, bits in ((config, range(8 * config.stat().st_size)), (params, flips)):
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
    for text in ("{}", "\x00", "[" * 100_000):
        config.write_text(text)
        assert "damaged" in refusal(config.parent)


ONE = {"dtype": "F32", "shape": [1], "data_offsets": [0, 4]}
TWO = {"dtype": "F32", "shape": [1], "data_offsets": [4, 8]}


def nested(depth):
    """A list in a list in a list ..."""
    value = []
    for _ in range(depth):
        value = [value]
    return value


def header(**entries):
    text = json.dumps(entries).encode()
    return len(text).to_bytes(8, "little") + text


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda all: all["config"].update(embedding_dim=8),
            "describes another network",
        ),
        (lambda all: all["config"].update(colour=1), "unknown field 'colour'"),
        (lambda all: all.update(config=[1]), "config must be an object, not (1,)"),
        (
            lambda all: all.update(format=True),
            "format must be a whole number, not True",
        ),
        (lambda all: all.update(format=2), "format 2 is not the format 3"),
        (lambda all: all.update(seen="A" * 15), "seen is not a fingerprint"),
        (lambda all: all.update(forecaster="nobody"), "unknown forecaster 'nobody'"),
        (lambda all: all.pop("dataset"), "the field 'dataset' is missing"),
        (
            lambda all: all.update(dataset={"a": 1}),
            "dataset must be text or be null, not {'a': 1}",
        ),
        (lambda all: all.update(plugins=3), "plugins must be a list, not 3"),
        (lambda all: all.update(plugins="os"), "plugins must be a list"),
        (
            lambda all: all.update(data={"a": 1}),
            "data must be an object, each value of which",
        ),
        (
            lambda all: all.update(neighbours=10**400),
            "neighbours must be a finite number",
        ),
        (
            lambda all: all["config"].update(period=1e308),
            "period must lie in (0, 3600]",
        ),
        (
            lambda all: all["config"].update(pred_len=10**9),
            "pred_len must lie in [1, 65536]",
        ),
        (
            lambda all: all["config"].update(pred_len=10**400),
            "not an integer of 1329 bits",
        ),
        (
            lambda all: all["config"].update(pooling=nested(500)),
            "pooling must be a Pooling",
        ),
        (
            lambda all: all.update({f"k{n}": 0 for n in range(60_000)}),
            "unknown field 'k0'",
        ),
        # Parameters that promise what is not there, or one that lies in another.
        (
            header(**{"a": ONE, "a/b": TWO}) + bytes(8),
            "name of a parameter and of a folder",
        ),
        (
            header(**{"a/b": ONE, "a": TWO}) + bytes(8),
            "name of a parameter and of a folder",
        ),
        (header(**{"/".join("a" * 5000): ONE}) + bytes(4), "a path of 5000 parts"),
        (b"", "cannot be read"),
        (header(), "describes another network"),
        (
            header(a={"dtype": "F32", "shape": [2**40], "data_offsets": [0, 2**42]}),
            "cannot be",
        ),
        (
            header(a={"dtype": "BF16", "shape": [1], "data_offsets": [0, 2]}) + b"00",
            "numbers",
        ),
        ((2**40).to_bytes(8, "little") + b"{}", "cannot be read"),
    ],
)
def test_wrong_values_under_a_right_digest(copy, change, message):
    sign(copy, params=change) if isinstance(change, bytes) else sign(copy, change)
    assert message in refusal(copy)


def test_shapes_of_an_earlier_version_are_left_out(copy):
    sign(copy, lambda all: all.update(seen="AAg0YAV/" * 3))
    with pytest.warns(InputWarning, match="kept shapes of its training otherwise"):
        assert load_model(copy).seen == ""


def test_parameters_of_a_forecaster_that_has_no_initial_ones(tmp_path):
    save_model(
        tmp_path / "m", Model(Lengths(), {"speed": 1.5}, None, "constant_velocity")
    )
    assert load_model(tmp_path / "m").params == {"speed": 1.5}


def test_parameters_that_are_not_finite(copy, tmp_path):
    model = dataclasses.replace(MODEL, params=jax.tree.map(np.array, MODEL.params))
    params = flat_parameters(model.params)
    params["params/encoder/lstm/input_bias"][3] = np.nan
    with pytest.raises(InputError, match="not finite: params/encoder/lstm/input_bias"):
        save_model(tmp_path / "new", model)
    from safetensors.numpy import save

    sign(copy, params=save(params))
    assert "not finite: params/encoder/lstm/input_bias" in refusal(copy)
    assert not (tmp_path / "new").exists()
    # Nor are those written that would not come back.
    odd = (
        (1, 2),
        {"a": [1.0]},
        {"a/b": np.zeros(1)},
        {"a": {}},
        {1: np.zeros(1)},
        {"a": "b"},
    )
    for params in odd:
        with pytest.raises(InputError, match="parameter"):
            flat_parameters(params)


def test_six_misfits_are_named_and_the_others_counted():
    seven = {name: np.zeros(2) for name in "abcdefg"}
    six = {name: seven[name] for name in "abcdef"}
    for arrays, end in (
        (six, "'f' is (2,), not expected"),
        (seven, "not expected and 1 more"),
    ):
        with pytest.raises(InputError, match=f"{re.escape(end)}$"):
            refuse_misfit(arrays, {}, "misfits")


def test_other_files_are_no_model_and_are_not_overwritten(saved, tmp_path):
    (tmp_path / "file").write_text("mine")
    for folder, message in (
        (saved, "already there, and nothing is overwritten"),
        (tmp_path / "file", "already there"),
        (tmp_path / "file" / "new", "cannot be written"),
    ):
        with pytest.raises(InputError, match=message):
            save_model(folder, dataclasses.replace(MODEL, dataset=None))
    assert "no such model" in refusal(tmp_path / "absent")
    assert "it has no config.json" in refusal(tmp_path)
    for content in (bytes(range(256)) * 9, b""):
        (tmp_path / "noise.pt").write_bytes(content)
        refusal(tmp_path / "noise.pt")
