import argparse
import dataclasses
import io
import json
import os
import pickle
import struct
import tracemalloc
import zipfile
from collections import OrderedDict, defaultdict

import numpy as np
import pytest

from neurosym_jax.errors import InputError
from neurosym_jax.interop import names, pickle_writer
from neurosym_jax.interop import torch as interop_torch
from neurosym_jax.interop.names import params_from_torch, params_to_torch
from neurosym_jax.interop.parity_case import generator_of
from neurosym_jax.interop.pickle_writer import write_torch_file
from neurosym_jax.interop.pickles import LEGACY_MAGIC, read_torch_file
from neurosym_jax.interop.stand_ins import StoredTensor
from neurosym_jax.interop.torch import export_torch_checkpoint, load_torch_checkpoint
from neurosym_jax.models.config import DiscriminatorConfig, GeneratorConfig

SMALL = GeneratorConfig(
    pooling="none", embedding_dim=2, encoder_h_dim=3, decoder_h_dim=4, mlp_dim=5, noise_dim=1
)
CONFIGS = [
    SMALL,
    GeneratorConfig(),
    GeneratorConfig(pool_every_timestep=True, decoder_h_dim=40, embedding_dim=8),
    GeneratorConfig(pooling="social,grid_size=4", noise_type="uniform"),
    GeneratorConfig(pooling="none", noise_dim=0, noise_mix_type="ped", pred_len=12),
]


def random_state(config):
    rng = np.random.default_rng(0)
    leaves = names._leaves(config)
    return {leaf.torch: rng.normal(size=leaf.shape[::-1]).astype(np.float32) for leaf in leaves}


def random_params(config):
    return params_from_torch(random_state(config), config)


def assert_same_tree(a, b):
    assert a.keys() == b.keys()
    for name in a:
        if isinstance(a[name], dict):
            assert_same_tree(a[name], b[name])
        else:
            assert a[name].dtype == b[name].dtype == np.float32
            np.testing.assert_array_equal(a[name], b[name])


def contents_of(config=SMALL, **changes):
    """What a checkpoint file holds, with some arguments changed; DROP removes one."""
    arguments = {
        "obs_len": 8,
        "pred_len": 8,
        "embedding_dim": config.embedding_dim,
        "encoder_h_dim_g": config.encoder_h_dim,
        "decoder_h_dim_g": config.decoder_h_dim,
        "mlp_dim": config.mlp_dim,
        "bottleneck_dim": 8,
        "noise_dim": (config.noise_dim,),
        "noise_type": "gaussian",
        "noise_mix_type": "global",
        "pooling_type": "none",
        "pool_every_timestep": False,
        "neighborhood_size": 2.0,
        "grid_size": 8,
        "batch_norm": False,
        "num_layers": 1,
        "dropout": 0.0,
        **changes,
    }
    arguments = {name: value for name, value in arguments.items() if value is not DROP}
    state = random_state(config)
    return {"g_state": OrderedDict(state), "args": arguments}


DROP = object()


def load_contents(path, contents):
    write_torch_file(path, contents, overwrite=True)
    return load_torch_checkpoint(path)


def as_legacy(zip_bytes):
    """The same checkpoint in the legacy form: a stream of pickles, then the storages."""
    with zipfile.ZipFile(io.BytesIO(zip_bytes)) as archive:
        keys = [n.rsplit("/", 1)[1] for n in archive.namelist() if "/data/" in n]
        program = archive.read("archive/data.pkl")
        storages = [archive.read(f"archive/data/{key}") for key in keys]
    return legacy_file(program, keys, storages)


def legacy_file(program, keys=(), storages=(), little_endian=True, protocol=1001):
    system = {"protocol_version": protocol, "little_endian": little_endian}
    parts = [pickle.dumps(part, 2) for part in (LEGACY_MAGIC, protocol, system)]
    parts += [program, pickle.dumps(list(keys), 2)]
    return b"".join(parts + [struct.pack("<q", len(s) // 4) + s for s in storages])


def zip_file(program):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("archive/data.pkl", program)
    return file.getvalue()


@pytest.fixture(scope="module")
def small_files(tmp_path_factory):
    """The bytes of one small checkpoint in both forms."""
    path = tmp_path_factory.mktemp("small") / "small.pt"
    export_torch_checkpoint(path, SMALL, random_params(SMALL), scene="eth")
    return {"zip": path.read_bytes(), "legacy": as_legacy(path.read_bytes())}


# Names and shapes


def test_published_names_and_shapes():
    state = params_to_torch(random_params(GeneratorConfig()), GeneratorConfig())
    shapes = {name: array.shape for name, array in state.items()}
    lstm = {"weight_ih_l0": (128, 16), "weight_hh_l0": (128, 32)}
    lstm |= {"bias_ih_l0": (128,), "bias_hh_l0": (128,)}
    dense = {
        "encoder.spatial_embedding": (16, 2),
        "decoder.spatial_embedding": (16, 2),
        "decoder.hidden2pos": (2, 32),
        "pool_net.spatial_embedding": (16, 2),
        "pool_net.mlp_pre_pool.0": (512, 48),
        "pool_net.mlp_pre_pool.2": (8, 512),
        "mlp_decoder_context.0": (64, 40),
        "mlp_decoder_context.2": (24, 64),
    }
    expected = {f"{part}.{part}.{k}": v for part in ("encoder", "decoder") for k, v in lstm.items()}
    expected |= {f"{name}.weight": shape for name, shape in dense.items()}
    expected |= {f"{name}.bias": shape[:1] for name, shape in dense.items()}
    assert shapes == expected


def test_kernels_are_transposed():
    state = random_state(SMALL)
    params = params_from_torch(state, SMALL)
    np.testing.assert_array_equal(
        params["encoder"]["lstm"]["recurrent_kernel"], state["encoder.encoder.weight_hh_l0"].T
    )
    np.testing.assert_array_equal(
        params["context_mlp"]["layer_1"]["kernel"], state["mlp_decoder_context.2.weight"].T
    )


@pytest.mark.parametrize("config", CONFIGS)
def test_generator_names_round_trip(config):
    params = random_params(config)
    again = params_from_torch(params_to_torch(params, config), config)
    assert_same_tree(params, again)


@pytest.mark.parametrize("kind", ["global", "local"])
def test_discriminator_names_round_trip(kind):
    config = DiscriminatorConfig(kind=kind)
    state = random_state(config)
    params = params_from_torch(state, config)
    assert ("pooling" in params) == (kind == "global")
    again = params_to_torch(params, config)
    assert again.keys() == state.keys()
    assert all(np.array_equal(again[name], state[name]) for name in state)


def test_golden_state_dicts_fit(shared):
    manifest = json.loads((shared / "golden/torch/manifest.json").read_text())
    rows = [row for row in manifest if row.get("model") == "sgan"]
    assert rows
    for row in rows:
        config = generator_of(row)
        d_config = DiscriminatorConfig(
            kind=row["d_type"],
            embedding_dim=row["embedding_dim"],
            h_dim=row["encoder_h_dim_d"],
            mlp_dim=row["mlp_dim"],
        )
        with np.load(shared / "golden/torch" / row["file"]) as arrays:
            g, d = (
                {k.split("/", 1)[1]: arrays[k] for k in arrays.files if k.startswith(prefix)}
                for prefix in ("g_state/", "d_state/")
            )
        g_again = params_to_torch(params_from_torch(g, config), config)
        d_again = params_to_torch(params_from_torch(d, d_config), d_config)
        for before, after in ((g, g_again), (d, d_again)):
            assert before.keys() == after.keys()
            assert all(np.array_equal(before[name], after[name]) for name in before)


def test_misfits_are_named():
    state = random_state(SMALL)
    del state["decoder.hidden2pos.bias"]
    state["encoder.encoder.bias_hh_l0"] = np.zeros(11, np.float32)
    state["pool_net_g.bias"] = np.zeros(1, np.float32)
    with pytest.raises(InputError) as error:
        params_from_torch(state, SMALL)
    message = str(error.value)
    assert "missing: 'decoder.hidden2pos.bias'" in message
    assert "unexpected: 'pool_net_g.bias'" in message
    assert "'encoder.encoder.bias_hh_l0' is [11], not [12]" in message


def test_misfits_of_our_tree_are_named_our_way():
    params = random_params(SMALL)
    del params["decoder"]["hidden2pos"]["bias"]
    with pytest.raises(InputError, match="missing: 'decoder/hidden2pos/bias'"):
        params_to_torch(params, SMALL)


def test_integer_weights_are_refused():
    state = random_state(SMALL)
    state["decoder.hidden2pos.bias"] = np.zeros(2, np.int64)
    with pytest.raises(InputError, match=r"not floating point: 'decoder\.hidden2pos\.bias'"):
        params_from_torch(state, SMALL)


# Export, then load


@pytest.mark.parametrize("config", CONFIGS)
def test_export_reads_back(tmp_path, config):
    params = random_params(config)
    export_torch_checkpoint(tmp_path / "a.pt", config, params, scene="zara1")
    loaded = load_torch_checkpoint(tmp_path / "a.pt")
    assert loaded.config == config
    assert loaded.scene == "zara1"
    assert loaded.discriminator is None
    assert loaded.arguments["encoder_h_dim_g"] == config.encoder_h_dim
    assert_same_tree(loaded.params, params)


def test_export_with_a_discriminator(tmp_path):
    config, d_config = GeneratorConfig(), DiscriminatorConfig()
    state = random_state(d_config)
    d_params = params_from_torch(state, d_config)
    path = tmp_path / "a.pt"
    export_torch_checkpoint(path, config, random_params(config), discriminator=(d_config, d_params))
    loaded = load_torch_checkpoint(path)
    assert loaded.scene is None
    assert loaded.discriminator is not None
    assert loaded.discriminator[0] == d_config
    assert_same_tree(loaded.discriminator[1], d_params)


def test_export_never_overwrites_silently(tmp_path):
    path = tmp_path / "a.pt"
    path.write_text("precious")
    with pytest.raises(InputError, match=r"a\.pt: exists already"):
        export_torch_checkpoint(path, SMALL, random_params(SMALL))
    assert path.read_text() == "precious"
    export_torch_checkpoint(path, SMALL, random_params(SMALL), overwrite=True)
    assert load_torch_checkpoint(path).config == SMALL
    assert os.listdir(tmp_path) == ["a.pt"]


def test_export_into_nowhere(tmp_path):
    (tmp_path / "no").write_text("")
    with pytest.raises(InputError, match=r"a\.pt: cannot be written"):
        export_torch_checkpoint(tmp_path / "no" / "a.pt", SMALL, random_params(SMALL))


def test_export_is_deterministic(tmp_path):
    for name in ("a.pt", "b.pt"):
        export_torch_checkpoint(tmp_path / name, SMALL, random_params(SMALL))
    assert (tmp_path / "a.pt").read_bytes() == (tmp_path / "b.pt").read_bytes()


def test_export_refuses_what_sgan_cannot_build(tmp_path):
    narrow = GeneratorConfig(pooling="pool_net,hidden_dim=64")
    with pytest.raises(InputError, match="fixed at 512, not 64"):
        export_torch_checkpoint(tmp_path / "a.pt", narrow, random_params(narrow))
    fixed = GeneratorConfig(noise_type="fixed", residual=True)
    with pytest.raises(InputError, match="noise_type fixed has no counterpart in torch"):
        export_torch_checkpoint(tmp_path / "a.pt", fixed, {})
    d_config = DiscriminatorConfig(kind="local", mlp_dim=7)
    state = random_state(d_config)
    discriminator = d_config, params_from_torch(state, d_config)
    with pytest.raises(InputError, match="one mlp_dim for generator and discriminator"):
        export_torch_checkpoint(
            tmp_path / "a.pt", SMALL, random_params(SMALL), discriminator=discriminator
        )
    assert not (tmp_path / "a.pt").exists()


# Arguments


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("obs_len", DROP, "obs_len is missing"),
        ("noise_dim", DROP, "noise_dim is missing"),
        ("batch_norm", True, "batch_norm is True, and our networks have False only"),
        ("activation", "leakyrelu", "activation is 'leakyrelu', and our networks have 'relu' only"),
        ("num_layers", 2, "num_layers is 2"),
        ("pooling_type", "attention", "one of 'none', 'pool_net', 'spool', not 'attention'"),
        ("pool_every_timestep", True, "needs a pooling"),
        ("pred_len", "12", "pred_len must be a whole number, not '12'"),
        ("noise_type", "cauchy", "one of gaussian, uniform, fixed, not 'cauchy'"),
        ("noise_dim", (4,), "noise_dim must lie in"),
        ("mlp_dim", 6, "'mlp_decoder_context.0.weight' is [5, 3], not [6, 3]"),
    ],
)
def test_arguments_we_cannot_follow(tmp_path, name, value, message):
    with pytest.raises(InputError) as error:
        load_contents(tmp_path / "a.pt", contents_of(**{name: value}))
    assert str(error.value).startswith(f"{tmp_path / 'a.pt'}: ")
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("name", "value"),
    [("dropout", 0.5), ("pooling_type", None), ("num_layers", DROP), ("noise_dim", 1)],
)
def test_arguments_that_change_no_network(tmp_path, name, value):
    loaded = load_contents(tmp_path / "a.pt", contents_of(**{name: value}))
    assert loaded.config == dataclasses.replace(SMALL)


@pytest.mark.parametrize("value", [None, (0,), 0, ()])
def test_no_noise(tmp_path, value):
    config = dataclasses.replace(SMALL, noise_dim=0)
    loaded = load_contents(tmp_path / "a.pt", contents_of(config, noise_dim=value))
    assert loaded.config.noise_dim == 0


@pytest.mark.parametrize("missing", ["g_state", "args"])
def test_a_checkpoint_without_weights_or_arguments(tmp_path, missing):
    contents = contents_of()
    contents[missing] = None
    with pytest.raises(InputError, match=f"has no {missing}"):
        load_contents(tmp_path / "a.pt", contents)


@pytest.mark.parametrize("value", [None, "weights", {}, 3])
def test_something_else_under_a_tensors_name(tmp_path, value):
    contents = contents_of()
    contents["g_state"]["decoder.hidden2pos.bias"] = value
    with pytest.raises(InputError, match=r"'decoder\.hidden2pos\.bias' is \[\], not \[2\]"):
        load_contents(tmp_path / "a.pt", contents)


def test_a_class_under_a_tensors_name():
    state = random_state(SMALL)
    state["decoder.hidden2pos.bias"] = StoredTensor
    with pytest.raises(InputError, match=r"is \[\], not \[2\]"):
        params_from_torch(state, SMALL)


def test_a_discriminator_that_is_none(tmp_path):
    assert load_contents(tmp_path / "a.pt", contents_of() | {"d_state": None}).discriminator is None
    with pytest.raises(InputError, match="d_state is not"):
        load_contents(tmp_path / "a.pt", contents_of() | {"d_state": "weights"})


# Damaged, foreign and hostile files


def test_legacy_form_reads_the_same(tmp_path, small_files):
    for form, data in small_files.items():
        (tmp_path / form).write_bytes(data)
    a, b = (load_torch_checkpoint(tmp_path / form) for form in ("zip", "legacy"))
    assert a.config == b.config
    assert a.arguments == b.arguments
    assert_same_tree(a.params, b.params)


@pytest.mark.parametrize("data", [b"", b"frame,id,x,y\n", b"\x80\x02}.", zip_file(b"")[:4]])
def test_foreign_files(tmp_path, data):
    path = tmp_path / "a.pt"
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"a\.pt: "):
        load_torch_checkpoint(path)


def test_not_a_file(tmp_path):
    for path in (tmp_path, tmp_path / "absent.pt"):
        with pytest.raises(InputError, match=str(path)):
            load_torch_checkpoint(path)


def test_foreign_zip(tmp_path):
    path = tmp_path / "a.pt"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("holiday.jpg", b"...")
    with pytest.raises(InputError, match="not one of torch"):
        load_torch_checkpoint(path)


def test_legacy_from_elsewhere(tmp_path):
    path = tmp_path / "a.pt"
    program = pickle.dumps({}, 2)
    path.write_bytes(legacy_file(program, little_endian=False))
    with pytest.raises(InputError, match="big-endian"):
        load_torch_checkpoint(path)
    path.write_bytes(legacy_file(program, protocol=1000))
    with pytest.raises(InputError, match="is not 1001"):
        load_torch_checkpoint(path)
    path.write_bytes(legacy_file(program) + b"more")
    with pytest.raises(InputError, match="4 bytes follow"):
        load_torch_checkpoint(path)


class Hostile:
    def __init__(self, command):
        self.command = command

    def __reduce__(self):
        return os.system, (self.command,)


@pytest.mark.parametrize("protocol", [2, 4])
@pytest.mark.parametrize("wrap", [zip_file, legacy_file])
def test_code_is_refused_by_name(tmp_path, wrap, protocol):
    path, trace = tmp_path / "a.pt", tmp_path / "trace"
    program = pickle.dumps({"g_state": {}, "args": Hostile(f"touch {trace}")}, protocol)
    path.write_bytes(wrap(program))
    with pytest.raises(InputError, match=rf"a\.pt: refused.*'{os.system.__module__}\.system'"):
        load_torch_checkpoint(path)
    assert not trace.exists()


@pytest.mark.parametrize(
    ("program", "message"),
    [
        (b"cos\nsystem\n.", r"'os\.system'"),
        (b"cbuiltins\neval\n.", r"'builtins\.eval'"),
        (b"(ios\nsystem\n.", "opcode INST"),
        (b"\x82\x01.", "opcode EXT1"),
        (b"}r\xff\xff\xff\x7f.", "memo index"),
        (b"ctorch.nn\nLinear\n.", r"'torch\.nn\.Linear'"),
        # Each of these would write into a class or an object of ours.
        (b"ctorch._utils\n_rebuild_tensor_v2\n}X\x01\x00\x00\x00aK\x01sb.", "damaged"),
        (b"ctorch\nSize\nN}X\x01\x00\x00\x00aK\x01s\x86b.", "damaged"),
        (b"ctorch\nFloatStorage\nN}X\x01\x00\x00\x00aK\x01s\x86b.", "damaged"),
        (b"ctorch._utils\n_rebuild_tensor_v2\n)\x81.", "damaged"),
        (b"(X\x06\x00\x00\x00modulectorch\nSize\nX\x01\x00\x00\x000NK\x01tQ.", "other than"),
    ],
)
@pytest.mark.parametrize("wrap", [zip_file, legacy_file])
def test_pickles_that_no_checkpoint_needs(tmp_path, wrap, program, message):
    path = tmp_path / "a.pt"
    path.write_bytes(wrap(b"\x80\x02" + program))
    with pytest.raises(InputError, match=message):
        load_torch_checkpoint(path)


def tensor_program(offset=0, shape=(2, 2), strides=(2, 1), numel=4, view=None):
    """The pickle of one tensor, by way of the writer's own: only the description differs."""

    def encode(value):
        return pickle_writer._encode(value, [])

    fields = b"".join(encode(v) for v in (offset, shape, strides, False))
    storage = encode("storage") + b"ctorch\nFloatStorage\n"
    storage += b"".join(encode(v) for v in ("0", "cuda:0", numel, view))
    call = b"ctorch._utils\n_rebuild_tensor_v2\n((" + storage + b"tQ" + fields + b"NtR"
    return b"\x80\x02" + call + b"."


@pytest.mark.parametrize(
    "description",
    [
        {"offset": 1},
        {"offset": -1},
        {"shape": (2, 3)},
        {"shape": (2, -2)},
        {"strides": (3, 1)},
        {"strides": (-2, 1)},
        {"shape": (2**30, 2**30), "strides": (0, 0)},
        {"shape": (4,)},
        {"numel": -1},
        {"view": ("v", 1, 3)},
        {"view": ("v", 1, 4)},
        {"view": ("v", 0.0, 4)},
        {"numel": 5},
        {"numel": 3},
    ],
)
def test_tensors_stay_within_their_storage(tmp_path, description):
    path = tmp_path / "a.pt"
    values = np.arange(4, dtype=np.float32)
    path.write_bytes(legacy_file(tensor_program(), ["0"], [values.tobytes()]))
    np.testing.assert_array_equal(read_torch_file(path), values.reshape(2, 2))
    path.write_bytes(legacy_file(tensor_program(**description), ["0"], [values.tobytes()]))
    with pytest.raises(InputError):
        read_torch_file(path)


def test_a_view_of_a_storage(tmp_path):
    """Until 2018 a storage could be a part of another."""
    path, values = tmp_path / "a.pt", np.arange(6, dtype=np.float32)
    program = tensor_program(numel=6, view=("v", 2, 4))
    path.write_bytes(legacy_file(program, ["0"], [values.tobytes()]))
    np.testing.assert_array_equal(read_torch_file(path), values[2:].reshape(2, 2))


def test_weights_that_are_not_finite(tmp_path):
    contents = contents_of()
    contents["g_state"]["decoder.hidden2pos.bias"][1] = np.inf
    with pytest.raises(InputError, match=r"not finite: decoder\.hidden2pos\.bias"):
        load_contents(tmp_path / "a.pt", contents)


def test_a_namespace_of_arguments(tmp_path):
    """As some training scripts save them."""
    path = tmp_path / "a.pt"
    space = argparse.Namespace(obs_len=8, noise_dim=(1,))
    path.write_bytes(zip_file(pickle.dumps({"args": space}, 2)))
    assert read_torch_file(path) == {"args": vars(space)}


def repeated(once, again, times):
    """A pickle that keeps `once` in its memo and then does `again` to it so often."""
    return b"\x80\x02(" + once + b"q\x00" + again * times + b"t."


def overlapping_zip(size, entries):
    """A zip whose many entries all hold the same bytes."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("archive/data.pkl", pickle.dumps({}, 2))
        archive.writestr("archive/data/0", bytes(size))
        first = archive.infolist()[1]
        for i in range(1, entries):
            info = zipfile.ZipInfo(f"archive/data/{i}")
            for name in ("CRC", "compress_size", "file_size", "header_offset"):
                setattr(info, name, getattr(first, name))
            archive.filelist.append(info)
    return file.getvalue()


BIG_LIST = b"](" + b"N" * 100_000 + b"e"
BIG_DICT = b"}(" + b"".join(b"J" + i.to_bytes(4, "little") + b"N" for i in range(50_000)) + b"u"


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (zip_file(repeated(BIG_LIST, b"ctorch\nSize\nh\x00\x85R", 20_000)), "made of a tuple"),
        (
            zip_file(repeated(BIG_DICT, b"ccollections\nOrderedDict\nh\x00\x85R", 20_000)),
            "damaged",
        ),
        (zip_file(b"\x80\x02" + b"]" * 1_000_000 + b"."), "more than 300000 opcodes"),
        (zip_file(b"\x80\x02U\x00" + b"\x00" * 2**24 + b"."), "larger than"),
        (legacy_file(b"\x80\x02X\xff\xff\xff\x01" + b" " * (2**25 - 1) + b"."), "damaged"),
        (zip_file(b"\x80\x02X\x00\x10\x00\x00" + b" " * 4096 + b"r\x00\x08\x00\x00."), "memo"),
        (overlapping_zip(2**20, 1000), "overlap"),
    ],
    ids=["sizes", "dictionaries", "opcodes", "long", "long legacy", "memo", "overlapping"],
)
def test_no_more_memory_than_the_file_has_bytes(tmp_path, data, message):
    path = tmp_path / "a.pt"
    path.write_bytes(data)
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=message):
            load_torch_checkpoint(path)
        assert tracemalloc.get_traced_memory()[1] < 10 * len(data) + 2e8
    finally:
        tracemalloc.stop()


def test_namespaces_share_their_attributes(tmp_path):
    path = tmp_path / "a.pt"
    program = repeated(BIG_DICT, b"cargparse\nNamespace\n)\x81h\x00b", 20_000)
    path.write_bytes(zip_file(program))
    tracemalloc.start()
    read_torch_file(path)
    assert tracemalloc.get_traced_memory()[1] < 1e8
    tracemalloc.stop()


def test_a_sparse_file_is_refused_before_it_is_read(tmp_path, monkeypatch):
    path = tmp_path / "a.pt"
    path.write_bytes(legacy_file(tensor_program(), ["0"], [bytes(16)]))
    os.truncate(path, 2**28)
    tracemalloc.start()
    with pytest.raises(InputError, match="bytes follow the last storage"):
        read_torch_file(path)
    assert tracemalloc.get_traced_memory()[1] < 2**26
    tracemalloc.stop()
    monkeypatch.setattr("neurosym_jax.runtime.memory.available_memory", lambda: 1e9)
    with pytest.raises(InputError, match="GB of memory"):
        read_torch_file(path)


def test_tensors_that_lie_over_each_other():
    state = {str(i): np.broadcast_to(np.float32(0), (100,)) for i in range(10)}
    with pytest.raises(InputError, match="more elements than the file can hold"):
        interop_torch._refuse_repeated(state, 1999)
    interop_torch._refuse_repeated(state, 2000)


@pytest.mark.parametrize("form", ["zip", "legacy"])
def test_truncated_anywhere(tmp_path, small_files, form):
    data, path = small_files[form], tmp_path / "a.pt"
    for length in [*range(0, len(data), 13), len(data) - 1]:
        path.write_bytes(data[:length])
        with pytest.raises(InputError, match=r"a\.pt: [^\n]+$"):
            load_torch_checkpoint(path)


@pytest.mark.filterwarnings("ignore:invalid escape sequence")
@pytest.mark.parametrize("form", ["zip", "legacy"])
def test_flipped_bytes(tmp_path, small_files, form):
    """A flip in a weight goes unnoticed (legacy files carry no checksum); none does worse."""
    original, path, rng = small_files[form], tmp_path / "a.pt", np.random.default_rng(0)
    messages = []
    for position in range(0, len(original), 5):  # Odd ones and even ones.
        data = bytearray(original)
        data[position] ^= rng.integers(1, 256)
        path.write_bytes(data)
        try:
            load_torch_checkpoint(path)
        except InputError as error:
            messages.append(str(error))
    assert len(messages) > 100
    assert all(text.startswith(f"{path}: ") and "\n" not in text for text in messages)


# Against torch itself


def test_published_checkpoints_equal_torch_load(shared, torch):
    paths = sorted((shared / "checkpoints").glob("*/*.pt"))
    assert len(paths) == 20
    for path in paths:
        theirs = torch.load(path, map_location="cpu", weights_only=True)
        ours = load_torch_checkpoint(path)
        pooling = "pool_net" if path.parent.name == "sgan-p-models" else "none"
        pred_len = int(path.name.split("_")[1])
        assert ours.config == GeneratorConfig(pooling=pooling, pred_len=pred_len)
        assert ours.scene == path.name.split("_")[0]
        assert ours.arguments == theirs["args"]
        state = params_to_torch(ours.params, ours.config)
        assert state.keys() == theirs["g_state"].keys()
        for name, tensor in theirs["g_state"].items():
            np.testing.assert_array_equal(state[name], tensor.numpy(), strict=True)


def test_published_checkpoint_damaged(shared, tmp_path):
    data = (shared / "checkpoints/sgan-p-models/zara1_12_model.pt").read_bytes()
    path, rng = tmp_path / "a.pt", np.random.default_rng(1)
    for length in range(0, len(data), 4001):
        path.write_bytes(data[:length])
        with pytest.raises(InputError):
            load_torch_checkpoint(path)
    for position in range(0, 4500, 11):
        damaged = bytearray(data)
        damaged[position] ^= rng.integers(1, 256)
        path.write_bytes(damaged)
        try:
            load_torch_checkpoint(path)
        except InputError:
            continue


@pytest.mark.parametrize("config", CONFIGS)
def test_export_opens_in_torch(tmp_path, torch, config):
    params = random_params(config)
    export_torch_checkpoint(tmp_path / "a.pt", config, params, scene="eth")
    theirs = torch.load(tmp_path / "a.pt", weights_only=True)
    assert type(theirs["g_state"]) is OrderedDict
    assert theirs["args"]["noise_dim"] == (config.noise_dim,)
    assert theirs["args"]["dataset_name"] == "eth"
    state = params_to_torch(params, config)
    assert state.keys() == theirs["g_state"].keys()
    for name, tensor in theirs["g_state"].items():
        np.testing.assert_array_equal(state[name], tensor.numpy(), strict=True)


@pytest.mark.parametrize("as_namespace", [False, True])
@pytest.mark.parametrize("zip_form", [False, True])
def test_training_checkpoint_written_by_torch(tmp_path, torch, zip_form, as_namespace):
    state = random_state(SMALL)
    d_config = DiscriminatorConfig(kind="local", embedding_dim=2, h_dim=3, mlp_dim=5)
    d_state = random_state(d_config)
    # As cuDNN leaves them: weights that are slices of one storage, at an offset.
    flat = torch.from_numpy(np.concatenate([array.ravel() for array in state.values()]))
    tensors, at = OrderedDict(), 0
    for name, array in state.items():
        tensors[name] = flat[at : at + array.size].reshape(array.shape)
        at += array.size
    name = "mlp_decoder_context.0.weight"
    tensors[name] = torch.nn.Parameter(torch.from_numpy(state[name].T.copy()).double().T)
    layer = torch.nn.Linear(2, 2)
    layer(torch.ones(2)).sum().backward()
    optimizer = torch.optim.Adam(layer.parameters())
    optimizer.step()
    arguments = contents_of(d_type="local", encoder_h_dim_d=3)["args"]
    losses = defaultdict(list)
    losses["G"] += [0.5, 0.25]
    contents = {
        "args": argparse.Namespace(**arguments) if as_namespace else arguments,
        "G_losses": losses,
        "counters": {"t": 1, "epoch": None},
        "norm_g": [torch.tensor(1.0)],
        "g_state": tensors,
        "g_best_state": layer.state_dict(),
        "g_optim_state": optimizer.state_dict(),
        "d_state": {k: torch.from_numpy(v) for k, v in d_state.items()},
        "empty": torch.zeros(0, 3),
    }
    path = tmp_path / "a.pt"
    torch.save(contents, path, _use_new_zipfile_serialization=zip_form)
    loaded = load_torch_checkpoint(path)
    assert loaded.config == SMALL
    assert_same_tree(loaded.params, params_from_torch(state, SMALL))
    assert loaded.discriminator is not None
    assert loaded.discriminator[0] == d_config
    assert loaded.arguments == arguments
    assert_same_tree(loaded.discriminator[1], params_from_torch(d_state, d_config))


@pytest.mark.parametrize("dtype", ["float64", "float16", "int64", "int32", "uint8", "bool"])
@pytest.mark.parametrize("zip_form", [False, True])
def test_dtypes_written_by_torch(tmp_path, torch, zip_form, dtype):
    tensor = torch.arange(6).reshape(2, 3).to(getattr(torch, dtype)).T
    scalar = torch.tensor(3)
    contents = {"a": tensor, "b": scalar, "c": tensor.shape}
    torch.save(contents, tmp_path / "a.pt", _use_new_zipfile_serialization=zip_form)
    read = read_torch_file(tmp_path / "a.pt")
    np.testing.assert_array_equal(np.asarray(read["a"]), tensor.numpy(), strict=True)
    assert np.asarray(read["b"]) == 3
    assert read["c"] == (3, 2)
