"""A training in torch and here, with the same batches, noises and labels."""

import dataclasses
import json

import pytest

from neurosym_jax.commands.parity import run
from neurosym_jax.errors import InputError
from neurosym_jax.interop.torch_side import FRESH_BIAS
from neurosym_jax.interop.training_parity import (
    DEAD,
    NETWORKS,
    TrainingParity,
    TrainingRow,
)
from tests.interop.test_modules import ARGUMENTS, NEUROSYM, SGAN, network_of
from tests.interop.test_torch_training import steps_of

OWN = {
    **ARGUMENTS, "d_type": "local", "encoder_h_dim_d": 9, "best_k": 2,
    "g_learning_rate": 1e-3, "d_learning_rate": 1e-3, "clipping_threshold_g": 0.7,
    "l2_loss_weight": 1.0,
}  # fmt: skip
ROW = TrainingRow(
    step=50,
    generator_float64=1e-9,
    discriminator_float64=1e-9,
    generator_float32=1e-2,
    discriminator_float32=1e-2,
    d_loss=1.3,
    moved=1e-2,
)


@pytest.fixture
def checkpoint(torch, tmp_path):
    path = tmp_path / "mine.pt"
    state = network_of(torch, ARGUMENTS).state_dict()
    torch.save({"g_state": state, "args": OWN}, path)
    return path


@pytest.mark.slow
def test_parameters_after_fifty_steps_are_torchs(checkpoint, tmp_path, capsys):
    module, out = f"{SGAN}:TrajectoryGenerator", tmp_path / "parity.json"
    assert run(torch_module=module, checkpoint=checkpoint, train=50, out=out) == 0
    report = json.loads(out.read_text())
    assert report["ok"]
    assert report["alive"]
    rows = {row["step"]: row for row in report["rows"]}
    assert list(rows) == [1, 10, 25, 50]
    last = rows[50]
    assert max(last["generator_float64"], last["discriminator_float64"]) < 1e-6
    # Float32 parts from torch's: columns of other numbers, not one twice.
    assert last["generator_float32"] > 10 * last["generator_float64"]
    losses = [row["d_loss"] for row in rows.values()]
    assert len(set(losses)) == 4
    assert report["assumed"][-1] == "new optimisers"
    assert "after 50 steps within 1e-06 in float64" in capsys.readouterr().out


@pytest.mark.slow
def test_a_training_of_neurosym_goes_on_from_its_optimisers(torch, tmp_path, capsys):
    """The first release, whose alpha is [T, P, 1], with Adams that have moved before."""
    models, path, code = tmp_path / "models_informed.py", tmp_path / "mine.pt", {}
    text = SGAN.read_text() + NEUROSYM.read_text()
    models.write_text(f"{text}\nTrajectoryDiscriminator = InformedDiscriminator\n")
    exec(text, code)
    torch.manual_seed(0)
    names = code["InformedGenerator"].__init__.__code__.co_varnames[1:11]
    network = code["FirstRelease"](**{name: ARGUMENTS[name] for name in names})
    critic = code["InformedDiscriminator"](8, 8, 6, 9, 24)
    with torch.no_grad():
        critic.real_classifier[-2].bias += FRESH_BIAS
    contents = {"args": OWN}
    for letter, part in (("g", network), ("d", critic)):
        adam, _ = steps_of(torch, part, 1e-3, 3)
        contents[f"{letter}_state"] = part.state_dict()
        contents[f"{letter}_optim_state"] = adam.state_dict()
    torch.save(contents, path)
    module, out = f"{models}:FirstRelease", tmp_path / "parity.json"
    assert run(torch_module=module, checkpoint=path, train=2, out=out) == 0
    report = json.loads(out.read_text())
    assert report["alive"]
    # Moments that were rounded to float32 differ by 1e-10.
    assert max(report["rows"][-1][f"{n}_float64"] for n in NETWORKS) < 1e-14
    assert "optimisers" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "verdict"),
    [
        ({}, "within 1e-06"),
        ({"generator_float64": 2e-6}, "MISS: not within"),
        ({"discriminator_float64": float("nan")}, "MISS: not within"),
        ({"d_loss": DEAD}, "discriminator is dead"),
        ({"moved": 0.0}, "or nothing moved"),
    ],
)
def test_the_verdict_is_of_both_networks_in_float64_and_alive(change, verdict):
    parity = TrainingParity((dataclasses.replace(ROW, **change),))
    assert verdict in str(parity)
    assert parity.ok == (not change)
    json.dumps(parity.to_json(), allow_nan=False)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"train": 0}, "--train must be"),
        ({"train": 2, "keep": "kept"}, "--keep: has no effect with --train"),
        ({"train": 2, "tolerance": -1.0}, "tolerance"),
    ],
)
def test_options_of_a_training(checkpoint, options, message):
    with pytest.raises(InputError, match=message):
        run(torch_module=f"{SGAN}:A", checkpoint=checkpoint, **options)
