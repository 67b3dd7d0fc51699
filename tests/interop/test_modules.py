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
from neurosym_jax.interop import run_parity, torch_side

SGAN = Path(__file__).with_name("sgan_torch.py")
ARGUMENTS = {
    "obs_len": 8,
    "pred_len": 8,
    "embedding_dim": 6,
    "mlp_dim": 24,
    "num_layers": 1,
    "encoder_h_dim": 12,
    "decoder_h_dim": 14,
    "noise_dim": (4,),
    "noise_type": "gaussian",
    "noise_mix_type": "global",
    "pooling_type": "pool_net",
    "pool_every_timestep": False,
    "bottleneck_dim": 5,
    "dropout": 0.0,
    "neighborhood_size": 2.0,
    "grid_size": 4,
}
EQUAL = "equal"
RELU = ("nn.ReLU,", "nn.LeakyReLU,")
ANOTHER_WAY = "its layers agree alone, the module's forward puts them together in another way"


def network_of(torch, arguments, change=None):
    """A generator of `sgan_torch.py`, of which a line is changed, with fresh weights."""
    text, code = SGAN.read_text(), {}
    assert change is None or change[0] in text
    exec(text if change is None else text.replace(*change), code)
    torch.manual_seed(0)
    network = code["TrajectoryGenerator"](**arguments)
    with torch.no_grad():
        for tensor in network.state_dict().values():
            size = 2 * tensor.shape[-1] ** -0.5  # Large enough to tell networks apart.
            tensor.uniform_(-size, size)
    return network


def write_case(folder, torch, network, arguments, change=lambda arrays: None):
    arrays, layers = torch_side.forecast(torch, network, torch_side.random_scenes(arguments, 0))
    change(arrays)
    np.savez(folder / "a.npz", **arrays)
    row = {"file": "a.npz", "model": "sgan", "layers": layers, **arguments}
    (folder / "manifest.json").write_text(json.dumps([row]))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "arguments", "wanted"),
    [
        (None, {}, EQUAL),
        (None, {"activation": "leakyrelu"}, "refused: args: activation is 'leakyrelu'"),
        (RELU, {}, "pool_net.mlp_pre_pool (alone): activation LeakyReLU, ours is ReLU"),
        (("512", "300"), {}, EQUAL),
        (None, {"mlp_dim": 20, "bottleneck_dim": 9, "embedding_dim": 3}, EQUAL),
        (None, {"dropout": 0.5}, EQUAL),
        (None, {"num_layers": 2}, "refused: args: num_layers is 2"),
        (None, {"noise_dim": (0,)}, EQUAL),
        (None, {"noise_mix_type": "ped", "pooling_type": None}, EQUAL),
        (None, {"obs_len": 5, "pred_len": 3, "pool_every_timestep": True}, EQUAL),
        (
            ("nn.Linear(h_dim, 2)\n", "nn.Linear(h_dim, 2)\n        self.head = nn.Linear(1, 3)\n"),
            {},
            "refused: the generator's parameters do not fit its configuration: 'decoder.head",
        ),
        (
            ("torch.cat([context, pooled]", "torch.cat([pooled, context]"),
            {},
            f"mlp_decoder_context: {ANOTHER_WAY}",
        ),
        (
            ("torch.cat([context, noise]", "torch.cat([noise, context]"),
            {},
            f"decoder, first state: {ANOTHER_WAY}",
        ),
        (
            ("nn.Sequential(*layers)", "nn.Sequential(*layers[:-1])"),
            {},
            "pool_net.mlp_pre_pool (alone): no ReLU after its last layer",
        ),
        (
            ("self.encoder(obs_traj_rel)", "self.encoder(obs_traj_rel.round(decimals=2))"),
            {},
            "obs_traj_rel: it is rounded to 2 decimals",
        ),
        (
            ("self.spatial_embedding(move)[None]", "move.new_zeros(1, len(move), 6)"),
            {},
            "decoder.spatial_embedding (alone): the checkpoint has it and the module never calls",
        ),
    ],
)
def test_a_changed_module_is_equal_refused_or_told_apart(
    tmp_path, torch, change, arguments, wanted
):
    arguments = ARGUMENTS | arguments
    write_case(tmp_path, torch, network_of(torch, arguments, change), arguments)
    try:
        rows = run_parity(tmp_path).rows
    except InputError as error:
        found = str(error).replace(f"{tmp_path / 'a.npz'}", "refused")
    else:
        reasons = [f"{row.output}: {row.reason}" for row in rows if row.reason]
        assert len(reasons) == (not all(row.ok for row in rows))
        found = (reasons or [EQUAL])[0]
    assert found.startswith(wanted)


def test_a_difference_in_one_layer_is_found_there_in_float64_too(torch, tmp_path):
    def change(arrays):
        arrays["out/decoder.hidden2pos"][3] += 0.1

    write_case(tmp_path, torch, network_of(torch, ARGUMENTS).double(), ARGUMENTS, change)
    (found,) = [row for row in run_parity(tmp_path).rows if not row.ok]
    assert found.output == "decoder.hidden2pos (alone)"
    assert found.max_abs == pytest.approx(0.1, rel=1e-3)


def test_the_command_runs_the_users_code_and_keeps_a_case(torch, tmp_path, capsys):
    (tmp_path / "sgan").mkdir()
    (tmp_path / "sgan" / "__init__.py").write_text("")
    models = tmp_path / "sgan" / "models.py"
    models.write_text(SGAN.read_text())
    path, kept = tmp_path / "mine.pt", tmp_path / "kept"
    state = network_of(torch, ARGUMENTS).state_dict()
    torch.save({"g_state": state, "args": ARGUMENTS}, path)
    options = Options(torch_module=f"{models}:TrajectoryGenerator", checkpoint=path, keep=kept)
    assert run(options) == 0
    assert "activation relu" in capsys.readouterr().out
    assert run(Options(kept)) == 0
    # What we export runs in the module and is the same network.
    convert.run(convert.Options(path, tmp_path / "folder"))
    convert.run(convert.Options(tmp_path / "folder", tmp_path / "again.pt"))
    again = Options(torch_module=options.torch_module, checkpoint=tmp_path / "again.pt")
    assert run(again) == 0
    models.write_text(SGAN.read_text().replace(*RELU))
    assert run(again) == 1
    assert "activation LeakyReLU, ours is ReLU" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("module", "python", "message"),
    [
        ("models.py", None, "must be FILE.py:CLASS"),
        ("absent.py:A", None, "must be FILE.py:CLASS"),
        (f"{SGAN}:Encoder", None, "failed: TypeError: Encoder"),
        (f"{SGAN}:TrajectoryGenerator", "nowhere", "--python nowhere: No such file"),
    ],
)
def test_a_module_that_does_not_run(module, python, message):
    if "TypeError" in message:
        pytest.importorskip("torch", reason="torch is not installed")
    small = Path(__file__).parents[1] / "golden" / "small.pt"
    with pytest.raises(InputError, match=message) as error:
        run(Options(torch_module=module, checkpoint=small, python=python))
    assert "\n" not in str(error.value)


def test_the_script_is_of_an_old_python_too():
    code = f"import ast; ast.parse(open({torch_side.__file__!r}).read(), feature_version=(3, 7))"
    subprocess.run([sys.executable, "-c", code], check=True)
    assert "neurosym_jax" not in Path(torch_side.__file__).read_text()
