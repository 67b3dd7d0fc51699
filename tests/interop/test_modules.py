"""A user's torch module: loaded and equal, or refused or told apart with the reason named."""

import ast
import itertools
import json
from collections import defaultdict
from pathlib import Path

import jax
import numpy as np
import pytest

from neurosym_jax.commands import convert
from neurosym_jax.commands.parity import run
from neurosym_jax.errors import InputError
from neurosym_jax.interop import compare, torch_side
from neurosym_jax.interop.checkpoint import model_from_torch
from neurosym_jax.models import Lengths, Model
from tests.repository import SMALL

SGAN = Path(__file__).with_name("sgan_torch.py")
ARGUMENTS = {
    "obs_len": 8, "pred_len": 8, "embedding_dim": 6, "mlp_dim": 24, "num_layers": 1,
    "encoder_h_dim": 12, "decoder_h_dim": 14, "bottleneck_dim": 5, "dropout": 0.0,
    "noise_dim": (4,), "noise_type": "gaussian", "noise_mix_type": "global",
    "pooling_type": "pool_net", "pool_every_timestep": False,
    "neighborhood_size": 2.0, "grid_size": 4,
}  # fmt: skip
EQUAL = "equal"
OTHER_SIZES = {
    "mlp_dim": 20,
    "bottleneck_dim": 9,
    "embedding_dim": 3,
    "encoder_h_dim": 5,
}
RELU = ("nn.ReLU()", "nn.LeakyReLU()")
ANOTHER_WAY = (
    "its layers agree alone, the module's forward puts them together in another way"
)


def network_of(torch, arguments, change=None):
    """A generator of `sgan_torch.py`, of which a line is changed, with fresh weights."""
    text, code = SGAN.read_text(), {}
    assert change is None or change[0] in text
    exec(text if change is None else text.replace(*change), code)
    torch.manual_seed(0)
    network = code["TrajectoryGenerator"](**arguments)
    with torch.no_grad():
        for tensor in network.parameters():
            size = 2 * tensor.shape[-1] ** -0.5  # Large enough to tell networks apart.
            tensor.uniform_(-size, size)
    return network


HEAD = (
    "nn.Linear(h_dim, 2)\n",
    "nn.Linear(h_dim, 2)\n        self.head = nn.Linear(1, 3)\n",
)
FIRST = "        self.encoder = nn.LSTM(embedding_dim, h_dim)\n"
SECOND = "        self.spatial_embedding = nn.Linear(2, embedding_dim)\n"
CONTEXT = "torch.cat([context, pooled]", "torch.cat([pooled, context]"
NOISE = "torch.cat([context, noise]", "torch.cat([noise, context]"
NO_LAST_RELU = "nn.Sequential(*layers)", "nn.Sequential(*layers[:-1])"
ROUNDED = "self.encoder(obs_traj_rel)", "self.encoder(obs_traj_rel.round(decimals=2))"
UNCALLED = "self.spatial_embedding(move)[None]", "move.new_zeros(1, len(move), 6)"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "arguments", "outcome"),
    [
        (RELU, {}, "pool_net.mlp_pre_pool (alone): activation LeakyReLU, ours is ReLU"),
        (("512", "300"), OTHER_SIZES, EQUAL),
        ((FIRST + SECOND, SECOND + FIRST), {}, EQUAL),
        (
            ("LSTM(embedding_dim, h_dim", "LSTM(embedding_dim, h_dim, 2"),
            {},
            "refused: the gene",
        ),
        (None, {"dropout": 0.5, "noise_dim": (0,)}, EQUAL),
        (None, {"noise_mix_type": "ped", "pooling_type": None}, EQUAL),
        (None, {"obs_len": 5, "pred_len": 3, "pool_every_timestep": True}, EQUAL),
        (
            HEAD,
            {},
            "refused: the generator's parameters do not fit its configuration: 'decoder.he",
        ),
        (CONTEXT, {}, f"mlp_decoder_context: {ANOTHER_WAY}"),
        (NOISE, {}, f"decoder, first state: {ANOTHER_WAY}"),
        (
            NO_LAST_RELU,
            {},
            "pool_net.mlp_pre_pool (alone): no ReLU after its last layer",
        ),
        (ROUNDED, {}, "obs_traj_rel: it is rounded to 2 decimals"),
        (
            UNCALLED,
            {},
            "decoder.spatial_embedding (alone): the checkpoint has it and the module",
        ),
    ],
)
def test_a_changed_module_is_equal_refused_or_told_apart(
    torch, change, arguments, outcome
):
    network = network_of(torch, ARGUMENTS | arguments, change)
    state = {name: value.numpy() for name, value in network.state_dict().items()}
    try:
        model = model_from_torch({"args": ARGUMENTS | arguments, "g_state": state})
        parity = compare(network, model)
    except InputError as error:
        outcomes = [f"refused: {error}"]
    else:
        assert "forward as in the released code; activation relu" in str(parity)
        outcomes = [f"{row.output}: {row.reason}" for row in parity.rows if row.reason]
        assert len(outcomes) == (not parity.ok)
    assert [text[: len(outcome)] for text in outcomes] == [outcome] * (outcome != EQUAL)
    assert "\n" not in "".join(outcomes)


@pytest.mark.slow
def test_modules_are_compared_on_scenes_of_ones_own_and_left_as_they_are(torch):
    network, cuda = network_of(torch, ARGUMENTS).double().train(), torch.Tensor.cuda
    state = {name: value.numpy() for name, value in network.state_dict().items()}
    model = model_from_torch({"args": ARGUMENTS, "g_state": state})
    walk = np.cumsum(np.random.default_rng(0).normal(0, 0.3, (9, 8, 2)), axis=1) + 40
    parity = compare(network, model, [walk[:3], walk[3:]])
    assert parity.ok
    assert next(row.shape for row in parity.rows if row.output == "pred_rel") == (
        9,
        8,
        2,
    )
    assert not any(module._forward_hooks for module in network.modules())
    assert network.training
    assert torch.Tensor.cuda is cuda
    with torch.no_grad():
        network.decoder.hidden2pos.bias[1] += 0.1
    (first,) = [row for row in compare(network, model, [walk]).rows if row.reason]
    assert first.output == "decoder.hidden2pos (alone)"
    assert first.max_abs == pytest.approx(0.1, rel=1e-3)
    for scenes, message in (
        ([walk[:, 1:]], "has 7 steps"),
        ([walk[0]], r"must be \[agents"),
    ):
        with pytest.raises(InputError, match=message):
            compare(network, model, scenes)
    with pytest.raises(InputError, match="has no counterpart in torch"):
        compare(network, Model(Lengths(), {}, family="constant_velocity"))


@pytest.mark.slow
def test_the_command_runs_the_users_code_and_keeps_a_case(torch, tmp_path, capsys):
    (tmp_path / "sgan").mkdir()
    (tmp_path / "sgan" / "__init__.py").write_text("")
    models = tmp_path / "sgan" / "models.py"
    models.write_text(SGAN.read_text())
    path, folder = tmp_path / "mine.pt", tmp_path / "kept"
    state = network_of(torch, ARGUMENTS).state_dict()
    losses = defaultdict(list, L=[1.0])  # As SGAN's train.py saves them.
    torch.save({"g_state": state, "args": ARGUMENTS, "G_losses": losses}, path)
    module = f"{models}:TrajectoryGenerator"
    assert run(torch_module=module, checkpoint=path, keep=folder) == 0
    assert "activation relu" in capsys.readouterr().out
    assert run(folder) == 0
    # What we export runs in the module and is the same network.
    convert.run(path, tmp_path / "folder", generator_only=True)
    convert.run(tmp_path / "folder", tmp_path / "again.pt")
    assert run(torch_module=module, checkpoint=tmp_path / "again.pt") == 0
    models.write_text(SGAN.read_text().replace(*RELU))
    assert run(torch_module=module, checkpoint=tmp_path / "again.pt") == 1
    assert "activation LeakyReLU, ours is ReLU" in capsys.readouterr().out


NEUROSYM = Path(__file__).with_name("neurosym_torch.py")


@pytest.mark.slow
@pytest.mark.parametrize("release", ["InformedGenerator", "FirstRelease"])
def test_the_command_compares_both_releases_of_neurosym(
    torch, tmp_path, capsys, release
):
    text, code = SGAN.read_text() + NEUROSYM.read_text(), {}
    models, path = tmp_path / "models_informed.py", tmp_path / "mine.pt"
    models.write_text(text)
    exec(text, code)
    torch.manual_seed(0)
    names = code["InformedGenerator"].__init__.__code__.co_varnames[1:11]
    network = code[release](**{name: ARGUMENTS[name] for name in names})
    torch.save({"g_state": network.state_dict(), "args": ARGUMENTS}, path)
    module, out = f"{models}:{release}", tmp_path / "parity.json"
    kept = tmp_path / "kept"
    assert run(torch_module=module, checkpoint=path, keep=kept, out=out) == 0
    report = json.loads(out.read_text())
    assert report["ok"]
    rows = {row["output"]: row for row in report["rows"]}
    assert {"pool_net_g", "pool_net_g.spatial_embedding (alone)"} < rows.keys()
    assert rows["pred_rel"]["max_abs"] < 1e-5
    assert run(kept) == 0
    # The networks are told apart by what alpha weights.
    models.write_text(
        text.replace("repeat(1, 1, self.emb", "pow(2).repeat(1, 1, self.emb")
    )
    assert run(torch_module=module, checkpoint=path, out=out) == 1
    rows = {row["output"]: row for row in json.loads(out.read_text())["rows"]}
    assert rows["encoder"]["ok"]
    assert not rows["pool_net_g"]["ok"]
    assert "MISS" in capsys.readouterr().out


def test_in_float64_a_network_of_doubles_is_compared_to_1e_12(torch):
    with jax.enable_x64(True):
        network = network_of(torch, ARGUMENTS).double()
        state = {name: value.numpy() for name, value in network.state_dict().items()}
        model = model_from_torch({"args": ARGUMENTS, "g_state": state})
        kernel = model.params["params"]["decoder"]["hidden2pos"]["kernel"]
        assert kernel.dtype == np.float64
        parity = compare(network, model, tolerance=1e-12)
        assert parity.ok, str(parity)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "python", "message"),
    [
        ("models.py", None, "must be FILE.py:CLASS"),
        ("absent.py:A", None, "must be FILE.py:CLASS"),
        (f"{SGAN}:Encoder", None, "failed: TypeError: Encoder"),
        (f"{SGAN}:TrajectoryGenerator", "nowhere", "python='nowhere': No such file"),
    ],
)
def test_a_module_that_does_not_run(module, python, message):
    if "TypeError" in message:
        pytest.importorskip("torch", reason="torch is not installed")
    with pytest.raises(InputError, match=message) as error:
        run(torch_module=module, checkpoint=SMALL, python=python)
    assert "\n" not in str(error.value)


def test_people_of_the_default_scenes_are_in_each_others_grid_of_social_pooling():
    distances = [
        np.abs(walk[:, None, time] - walk[:, time]).max(axis=-1)[
            np.triu_indices(len(walk), 1)
        ]
        for walk, time in itertools.product(torch_side.random_walks(16, 0), (7, -1))
    ]
    near = [(pairs < 1).any() for pairs in distances if len(pairs)]
    assert sum(near) >= 4
    assert max(pairs.max(initial=0) for pairs in distances) > 1


def test_the_script_is_of_an_old_python_too():
    text = Path(torch_side.__file__).read_text()
    ast.parse(text, feature_version=(3, 7))
    assert "neurosym_jax" not in text
