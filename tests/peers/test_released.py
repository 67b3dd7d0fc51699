"""The released code of SGAN and of both releases of NeuroSyM, run beside ours."""

import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neurosym_jax.commands.parity import run
from neurosym_jax.data.windows import bucket_of
from neurosym_jax.interop import compare, torch_side
from neurosym_jax.interop.checkpoint import model_from_torch
from neurosym_jax.models.forecast import checked_scene, predict
from neurosym_jax.models.forecaster import key_numbers, key_of, scene_noise

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


def loaded(peer, release):
    """The file of a release, and what it defines."""
    names = ("sgan", "NeuroSyM-prediction", "neuROSym")
    path, code = peer(*names) / CODE[release], {"__name__": release}
    exec(path.read_text(), code)
    return path, code


def fresh(torch, network_class, arguments, seed):
    """A network of the release's constructor with torch's own first weights."""
    given = {}
    for name in inspect.signature(network_class).parameters:
        for key in (name, f"{name}_g"):
            if key in arguments:
                given[name] = arguments[key]
    torch.manual_seed(seed)
    return network_class(**given)


@pytest.fixture
def checkpoint(peer, tmp_path, release, kind):
    """The file and a checkpoint of its constructor, with fresh weights."""
    torch = pytest.importorskip("torch")
    path, code = loaded(peer, release)
    state = fresh(torch, code["TrajectoryGenerator"], ARGUMENTS, 0).state_dict()
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


def drawn(rng, release):
    """Arguments of a constructor, and people who walk at random, [N, obs_len, 2] metres."""
    arguments = ARGUMENTS | {
        "obs_len": int(rng.integers(2, 65)),
        "pred_len": int(rng.integers(1, 65)),
        "embedding_dim": int(rng.integers(1, 20)),
        "encoder_h_dim_g": int(rng.integers(1, 40)),
        "decoder_h_dim_g": int(rng.integers(9, 40)),
        "bottleneck_dim": int(rng.integers(1, 20)),
        "noise_mix_type": str(rng.choice(["global", "ped"])),
    }
    if release == "sgan":
        kind = str(rng.choice(["none", "pool_net", "spool"]))
        arguments["pooling_type"] = kind
        if kind == "spool":
            arguments["bottleneck_dim"] = arguments["encoder_h_dim_g"]
        arguments["pool_every_timestep"] = kind == "pool_net" and rng.random() < 0.3
    people = int(np.exp(rng.uniform(0, np.log(200.5))))
    steps = rng.normal(0, rng.uniform(0, 2), (people, arguments["obs_len"], 2))
    walk = rng.normal(0, 3, (people, 1, 2)) + steps.cumsum(axis=1)
    return arguments, walk.round(4)


def torchs(torch, network, model, walk):
    """Torch's forecast of the noise and the weights that `predict` takes, metres."""
    scene = checked_scene(model, walk, "", 0)
    spec = model.forecaster.noise
    people = len(walk) if spec.per_agent else 1
    slots = int(bucket_of(len(walk))) if spec.per_agent else 1
    key, identity = key_of(jnp.array(key_numbers(0))), jnp.array(scene.identity)
    noise = scene_noise(spec, key, identity, 1, slots)
    dtype = next(network.parameters()).dtype
    arrays = {"traj": walk, "traj_rel": np.diff(walk, axis=1, prepend=walk[:, :1])}
    places = [torch.tensor(a, dtype=dtype).transpose(0, 1) for a in arrays.values()]
    bounds = torch.tensor([[0, len(walk)]])
    weights = ()
    if model.weighting is not None:
        alpha = np.asarray(model.weighting.alpha({}, scene.observed))
        alpha = torch.tensor(alpha.reshape(-1, walk.shape[1]), dtype=dtype)
        weights = torch_side.alpha_arguments(torch, network, alpha, bounds)
    noise = torch.tensor(np.asarray(noise).reshape(slots, -1)[:people], dtype=dtype)
    with torch.no_grad():
        moves = network(
            *(place.contiguous() for place in places),
            *weights,
            bounds,
            user_noise=noise,
        )
    return walk[:, -1:] + moves.transpose(0, 1).double().cumsum(dim=1).numpy()


@pytest.mark.parametrize("wide", [False, True], ids=["float32", "float64"])
@pytest.mark.parametrize("release", CODE)
def test_fresh_constructors_forecast_alike(peer, monkeypatch, release, wide):
    """20 of each release, by every layer, and by `predict` where the release has it."""
    torch = pytest.importorskip("torch")
    _, code = loaded(peer, release)
    monkeypatch.setattr(torch.Tensor, "cuda", lambda self, *_: self)
    torch.set_default_dtype(torch.float64 if wide else torch.float32)
    largest = 0.0
    with jax.enable_x64(wide):
        for number in range(20):
            arguments, walk = drawn(np.random.default_rng(number), release)
            network = fresh(torch, code["TrajectoryGenerator"], arguments, number)
            network = network.to(torch.get_default_dtype()).eval()
            state = {n: a.numpy() for n, a in network.state_dict().items()}
            model = model_from_torch({"args": arguments, "g_state": state})
            tolerance = 1e-12 if wide else 1e-5
            parity = compare(network, model, [walk], tolerance=tolerance)
            # Torch sums positions far from the origin in its own type.
            misses = {row.output for row in parity.rows if not row.ok} - {"pred_abs"}
            assert not misses, f"{number}: {arguments}\n{parity}"
            if release == "first release":
                continue
            theirs = torchs(torch, network, model, walk)
            ours = predict(model, walk, samples=1)[0]
            scale = np.abs(theirs).max() if wide else 1
            difference = np.abs(ours - theirs).max() / scale
            largest = max(largest, difference)
            print(number, len(walk), walk.shape[1], f"{difference:.1e}", flush=True)
            assert difference <= tolerance, (number, arguments)
    torch.set_default_dtype(torch.float32)
    print(release, f"{largest:.1e}")
