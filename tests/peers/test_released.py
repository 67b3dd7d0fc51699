"""The released code of SGAN and of both releases of NeuroSyM, run beside ours."""

import inspect

import pytest

from neurosym_jax.commands.parity import run

CODE = {
    "sgan": "sgan/sgan/models.py",
    "first release": "NeuroSyM-prediction/NeuroSyM-sgan/scripts/sgan/models_informed.py",
    "robot package": "neuROSym/motion_predict/neurosym_sgan/scripts/sgan/models_informed.py",
}
ARGUMENTS = {
    "obs_len": 8, "pred_len": 8, "embedding_dim": 16, "encoder_h_dim_g": 32,
    "decoder_h_dim_g": 32, "encoder_h_dim_d": 48, "mlp_dim": 64, "bottleneck_dim": 8,
    "num_layers": 1, "dropout": 0.0, "batch_norm": False, "noise_dim": (8,),
    "noise_type": "gaussian", "noise_mix_type": "global", "pooling_type": "pool_net",
    "pool_every_timestep": False, "neighborhood_size": 2.0, "grid_size": 8,
    "best_k": 5, "g_learning_rate": 1e-3, "d_learning_rate": 1e-3,
    "clipping_threshold_g": 1.5, "l2_loss_weight": 1.0,
}  # fmt: skip


@pytest.fixture
def checkpoint(peer, tmp_path, release, kind):
    """The file and a checkpoint of its constructor, with fresh weights."""
    torch = pytest.importorskip("torch")
    names = ("sgan", "NeuroSyM-prediction", "neuROSym")
    path, code = peer(*names) / CODE[release], {"__name__": release}
    exec(path.read_text(), code)
    network_class = code["TrajectoryGenerator"]
    arguments = {}
    for name in inspect.signature(network_class).parameters:
        for key in (name, f"{name}_g"):
            if key in ARGUMENTS:
                arguments[name] = ARGUMENTS[key]
    torch.manual_seed(0)
    state = network_class(**arguments).state_dict()
    contents = {"g_state": state, "args": ARGUMENTS | {"d_type": kind}}
    torch.save(contents, tmp_path / "fresh.pt")
    return f"{path}:TrajectoryGenerator", tmp_path / "fresh.pt"


@pytest.mark.parametrize("kind", ["local", "global"])
@pytest.mark.parametrize("release", CODE)
def test_forecasts_and_fifty_steps_of_a_training_agree(checkpoint, capsys):
    module, path = checkpoint
    assert run(torch_module=module, checkpoint=path) == 0
    assert run(torch_module=module, checkpoint=path, train=50) == 0
    print(capsys.readouterr().out)
