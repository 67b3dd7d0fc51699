"""A user's torch module: loaded and equal, or refused or told apart with the reason named."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from neurosym_jax.commands import convert
from neurosym_jax.commands.parity import Options, run
from neurosym_jax.errors import InputError
from neurosym_jax.interop import compare, run_parity, torch_side
from neurosym_jax.interop.checkpoint import model_from_torch

SGAN = Path(__file__).with_name("sgan_torch.py")
ARGUMENTS = {
    "obs_len": 8,
    "pred_len": 8,
    "embedding_dim": 6,
    "mlp_dim": 24,
    "num_layers": 1,
    "encoder_h_dim_g": 12,
    "decoder_h_dim_g": 14,
    "noise_dim": (4,),
    "noise_type": "gaussian",
    "noise_mix_type": "global",
    "pooling_type": "pool_net",
    "pool_every_timestep": False,
    "bottleneck_dim": 5,
    "dropout": 0.0,
    "batch_norm": False,
    "neighborhood_size": 2.0,
    "grid_size": 4,
    "d_type": "global",
    "encoder_h_dim_d": 7,
}
EQUAL = "equal"
# Lines of the module, and what stands there instead.
RELU = ("nn.ReLU,", "nn.LeakyReLU,")
HEAD = ("nn.Linear(h_dim, 2)\n", "nn.Linear(h_dim, 2)\n        self.head = nn.Linear(h_dim, 3)\n")
LOOP = (
    "for start, end in bounds.tolist():\n            h, p = hidden[start:end], position[start:end]"
    "\n            apart = self"
)
BIASES = ("dropout=dropout)\n        self.sp", "dropout=dropout, bias=False)\n        self.sp")
CALL = "self.encoder(obs_traj_rel)\n        context"


def changed_module(change=None):
    text = SGAN.read_text()
    if change is not None:
        assert change[0] in text
        text = text.replace(*change)
    return text


def checkpoint(torch, text, arguments):
    """A generator of this code with fresh weights, and what its training would save."""
    code: dict = {}
    exec(text, code)
    torch.manual_seed(0)
    given = {k.removesuffix("_g"): v for k, v in arguments.items() if not k.endswith("_d")}
    network = code["TrajectoryGenerator"](**{k: v for k, v in given.items() if k != "d_type"})
    with torch.no_grad():
        for name, tensor in network.state_dict().items():
            if "num_batches" not in name:  # Weights large enough to tell networks apart.
                size = 2 * tensor.shape[-1] ** -0.5
                tensor.uniform_(size / 4 if "running_var" in name else -size, size)
    return network, {"g_state": network.state_dict(), "args": dict(arguments)}


def verdict(torch, change, arguments, double=False):
    """`EQUAL`, the reason for which a checkpoint is refused, or the first difference."""
    network, contents = checkpoint(torch, changed_module(change), {**ARGUMENTS, **arguments})
    if double:
        network = network.double()
        contents["g_state"] = network.state_dict()
    try:
        loaded = model_from_torch(contents)
    except InputError as error:
        return f"refused: {error}"
    parity = compare(network, loaded)
    differences = [f"{row.output}: {row.reason}" for row in parity.rows if row.reason]
    assert len(differences) == (not parity.ok)
    return EQUAL if parity.ok else differences[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "arguments", "wanted"),
    [
        (None, {}, EQUAL),
        (None, {"activation": "leakyrelu"}, "refused: args: activation is 'leakyrelu'"),
        (RELU, {}, "pool_net.mlp_pre_pool (alone): activation LeakyReLU, ours is ReLU"),
        (("512", "300"), {}, EQUAL),
        (None, {"mlp_dim": 20, "bottleneck_dim": 9, "embedding_dim": 3}, EQUAL),
        (None, {"batch_norm": True}, EQUAL),
        (None, {"batch_norm": True, "dropout": 0.3, "pool_every_timestep": True}, EQUAL),
        (None, {"num_layers": 2}, "refused: args: num_layers is 2"),
        (None, {"dropout": 0.5}, EQUAL),
        (None, {"noise_dim": (0,)}, EQUAL),
        (None, {"noise_mix_type": "ped", "pooling_type": None}, EQUAL),
        (None, {"obs_len": 5, "pred_len": 3}, EQUAL),
        (None, {"pooling_type": "spool", "bottleneck_dim": 12}, EQUAL),
        (HEAD, {}, "refused: the generator's parameters do not fit its configuration: unexpected"),
        (
            ("torch.cat([context, pooled]", "torch.cat([pooled, context]"),
            {},
            "mlp_decoder_context: the pooled vector before the hidden state",
        ),
        (
            ("torch.cat([context, noise]", "torch.cat([noise, context]"),
            {},
            "decoder, first state: noise before the context",
        ),
        (
            ("nn.Sequential(*layers)", "nn.Sequential(*layers[:-1])"),
            {},
            "pool_net.mlp_pre_pool (alone): no ReLU after its last layer",
        ),
        (
            (LOOP, LOOP.replace("bounds.tolist()", "[(0, len(hidden))]")),
            {},
            "pool_net: scene boundaries",
        ),
        (
            (CALL, CALL.replace("rel)", "rel.round(decimals=2))")),
            {},
            "obs_traj_rel: it is rounded to 2 decimals",
        ),
        (
            ("return hidden\n", "return hidden * 0.5\n"),
            {},
            "encoder: its layers agree alone",
        ),
        (
            ("self.hidden2pos(state[0][0])", "self.hidden2pos(state[0][0]) * 1.1"),
            {},
            "pred_rel: its layers agree alone",
        ),
        (
            ("self.spatial_embedding(move)[None]", "move.new_zeros(1, len(move), 6)"),
            {},
            "decoder.spatial_embedding (alone): the checkpoint has it and the module never calls",
        ),
        (
            BIASES,
            {},
            "refused: the generator's parameters do not fit its configuration: missing: 'encoder",
        ),
    ],
)  # fmt: skip
def test_a_changed_module_is_equal_refused_or_told_apart(torch, change, arguments, wanted):
    assert verdict(torch, change, arguments).startswith(wanted)


def test_float64(torch):
    assert verdict(torch, None, {}, double=True) == EQUAL


ONE_BIAS = """
class LSTM(torch.nn.LSTM):
    def forward(self, x, state=None):
        with torch.no_grad():
            self.bias_hh_l0.zero_()
        return super().forward(x, state)
"""
GATES = """
class LSTM(torch.nn.LSTM):
    def forward(self, x, state=None):
        with torch.no_grad():
            for each in self.parameters():
                i, f, g, o = each.clone().chunk(4)
                each.copy_(torch.cat([i, g, f, o]))
        return super().forward(x, state)
"""


@pytest.mark.parametrize(
    ("cell", "reason"),
    [
        (ONE_BIAS, "it has one bias and not two: bias_hh_l0 is left out"),
        (GATES, "its gates are in the order i, g, f, o, ours i, f, g, o"),
    ],
)
def test_another_lstm(torch, cell, reason):
    network, contents = checkpoint(torch, SGAN.read_text(), ARGUMENTS)
    model = model_from_torch(contents)
    code = {"torch": torch}
    exec(cell, code)
    network.encoder.encoder.__class__ = code["LSTM"]
    (row,) = [row for row in compare(network, model).rows if row.reason]
    assert (row.output, row.reason) == ("encoder.encoder (alone)", reason)


def test_own_scenes(torch):
    network, contents = checkpoint(torch, SGAN.read_text(), ARGUMENTS)
    model = model_from_torch(contents)
    rng = np.random.default_rng(0)
    scenes = [np.cumsum(rng.normal(size=(n, 8, 2)), axis=1) for n in (2, 4)]
    assert compare(network, model, scenes).ok
    with pytest.raises(InputError, match=r"scene 0 is \[2, 7, 2\], not \[agents, 8, 2\]"):
        compare(network, model, [scenes[0][:, 1:]])
    network.forward = lambda a, b, c, alpha: None
    with pytest.raises(InputError, match="forward needs alpha, which SGAN's has not"):
        compare(network, model)


def test_the_command_runs_the_users_code_and_keeps_cases(torch, tmp_path, capsys):
    (tmp_path / "sgan").mkdir()
    (tmp_path / "sgan" / "__init__.py").write_text("")
    models = tmp_path / "sgan" / "models.py"
    models.write_text(SGAN.read_text())
    _, contents = checkpoint(torch, SGAN.read_text(), ARGUMENTS)
    code: dict = {}
    exec(SGAN.read_text(), code)
    sizes = {name: ARGUMENTS[name] for name in ("obs_len", "pred_len", "embedding_dim", "mlp_dim")}
    judge = code["TrajectoryDiscriminator"](h_dim=7, d_type="global", batch_norm=False, **sizes)
    contents["d_state"] = judge.state_dict()
    path, kept = tmp_path / "mine.pt", tmp_path / "kept"
    torch.save(contents, path)
    options = Options(torch_module=f"{models}:TrajectoryGenerator", checkpoint=(path,), keep=kept)
    assert run(options) == 0
    said = capsys.readouterr().out
    assert "activation relu" in said
    assert "d_scores_fake" in said
    assert run(Options(kept)) == 0
    models.write_text(changed_module(RELU))
    again = Options(torch_module=f"{models}:TrajectoryGenerator", checkpoint=(path,))
    assert run(again) == 1
    assert "activation LeakyReLU, ours is ReLU" in capsys.readouterr().out
    # What we export runs in the module and is the same network.
    convert.run(convert.Options(path, tmp_path / "folder"))
    convert.run(convert.Options(tmp_path / "folder", tmp_path / "again.pt"))
    models.write_text(SGAN.read_text())
    module = f"{models}:TrajectoryGenerator"
    assert run(Options(torch_module=module, checkpoint=(tmp_path / "again.pt",))) == 0


@pytest.mark.parametrize(
    ("module", "python", "message"),
    [
        ("models.py", None, "must be FILE.py:CLASS"),
        ("absent.py:A", None, "must be FILE.py:CLASS"),
        (f"{SGAN}:Encoder", None, "failed: RuntimeError: Error"),
        (f"{SGAN}:TrajectoryGenerator", "nowhere", "--python nowhere: No such file"),
    ],
)
def test_a_module_that_does_not_run(module, python, message):
    if "RuntimeError" in message:
        pytest.importorskip("torch", reason="torch is not installed")
    small = Path(__file__).parents[1] / "golden" / "small.pt"
    with pytest.raises(InputError, match=message) as error:
        run(Options(torch_module=module, checkpoint=(small,), python=python))
    assert "\n" not in str(error.value)


def test_the_script_is_of_an_old_python_too():
    code = f"import ast; ast.parse(open({torch_side.__file__!r}).read(), feature_version=(3, 7))"
    subprocess.run([sys.executable, "-c", code], check=True)
    assert "neurosym_jax" not in Path(torch_side.__file__).read_text().split('"""', 2)[2]


def test_layers_of_a_kept_case(torch, tmp_path):
    """A difference planted in a stored layer is found in that layer."""
    network, contents = checkpoint(torch, SGAN.read_text(), ARGUMENTS)
    scenes = torch_side.random_scenes(ARGUMENTS, np.random.RandomState(0))
    arrays, layers = torch_side.forecast(torch, network, scenes)
    arrays["out/decoder.hidden2pos"][3] += 0.1
    np.savez(tmp_path / "a.npz", **arrays)
    row = {"file": "a.npz", "model": "sgan", "layers": layers, **contents["args"]}
    del row["d_type"]
    (tmp_path / "manifest.json").write_text(json.dumps([row]))
    (found,) = [row for row in run_parity(tmp_path).rows if not row.ok]
    assert found.output == "decoder.hidden2pos (alone)"
    assert found.max_abs == pytest.approx(0.1, rel=1e-3)
