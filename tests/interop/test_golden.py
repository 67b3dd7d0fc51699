"""Parity in a clone alone: the stored cases, and the command that makes such."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from neurosym_jax.commands.golden import Options, run
from neurosym_jax.errors import InputError
from neurosym_jax.interop.parity import format_parity, run_parity

GOLDEN = Path(__file__).parents[1] / "golden"


@pytest.mark.rounding
@pytest.mark.parametrize("folder", ["published", "fresh"])
def test_stored_cases(folder):
    rows = run_parity(GOLDEN / folder)
    assert all(row.ok for row in rows), format_parity(rows)
    outputs = {row.output for row in rows}
    assert (
        outputs
        >= {
            "published": {"pred_rel", "pred_abs"},
            "fresh": {"pred_rel", "pred_abs", "d_scores_fake"},
        }[folder]
    )


def test_the_stored_cases_are_small_and_prove_something():
    assert sum(path.stat().st_size for path in GOLDEN.rglob("*") if path.is_file()) < 1_000_000
    for path in GOLDEN.glob("[pf]*/*.npz"):
        with np.load(path) as arrays:
            assert np.abs(arrays["pred_rel"]).max() > 0.01
            assert "d_scores_fake" not in arrays or arrays["d_scores_fake"].min() > 0
            assert {array.dtype.kind for array in arrays.values()} <= {"f", "i"}
            assert all(a.dtype == np.float32 for a in arrays.values() if a.dtype.kind == "f")


# As much of torch and of SGAN as the script asks for: what it hands over is what is tested.
TORCH = """
import contextlib, numpy as np
class Tensor:
    def __init__(self, array): self.a = np.asarray(array)
    def transpose(self, i, j): return Tensor(self.a.swapaxes(i, j))
    def contiguous(self): return self
    def cumsum(self, dim): return Tensor(self.a.cumsum(dim))
    def numpy(self): return self.a
    def __getitem__(self, at): return Tensor(self.a[at])
    def __add__(self, other): return Tensor(self.a + other.a)
class nn:
    class Module: pass
float32 = np.float32
def tensor(array, dtype=None): return Tensor(np.asarray(array, dtype))
def manual_seed(seed): pass
no_grad = contextlib.nullcontext
def load(path, map_location, weights_only):
    assert weights_only and map_location == "cpu"
    args = dict(obs_len=3, pred_len=2, embedding_dim=4, mlp_dim=4, bottleneck_dim=3)
    args.update(encoder_h_dim_g=5, decoder_h_dim_g=6, noise_dim=(2,), noise_type="gaussian")
    args.update(noise_mix_type="global", pooling_type=None, pool_every_timestep=False)
    return {"g_state": {"w": 1}, "args": args}
"""
MODELS = """
import torch, numpy as np
class TrajectoryGenerator(torch.nn.Module):
    def __init__(self, **given): assert given["decoder_h_dim"] == 6; self.steps = given["pred_len"]
    def load_state_dict(self, state): self.state = state
    def state_dict(self): return {"w": torch.tensor(np.ones(3, np.float32))}
    def eval(self): return self
    def __call__(self, seen, moves, scenes, user_noise):
        assert seen.cuda() is seen and user_noise.a.shape == (len(scenes.a), 2)
        return torch.tensor(np.repeat(moves.a[-1:], self.steps, 0))
"""


@pytest.fixture
def checkout(tmp_path):
    folder = tmp_path / "checkout"
    (folder / "sgan").mkdir(parents=True)
    (folder / "torch.py").write_text(TORCH)
    (folder / "sgan" / "models.py").write_text(MODELS)
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "mine.pt").write_bytes(b"whatever")
    return folder


def test_a_case_is_made_of_a_checkpoint(checkout, tmp_path, capsys):
    out = tmp_path / "cases"
    run(Options(checkout, out, (tmp_path / "models" / "mine.pt",)))
    assert f"neurosym parity {out}" in capsys.readouterr().out
    (row,) = json.loads((out / "manifest.json").read_text())
    assert (row["file"], row["model"], row["decoder_h_dim"]) == ("models_mine.npz", "sgan", 6)
    with np.load(out / row["file"]) as arrays:
        steps = np.diff(arrays["traj"], axis=1, prepend=arrays["traj"][:, :1])
        np.testing.assert_allclose(arrays["traj_rel"], steps, atol=1e-5)
        assert arrays["scene_start_end"].tolist() == [[0, 3], [3, 5], [5, 6], [6, 11]]
        assert not arrays["traj_rel"][[0, 6]].any()  # They stand.
        np.testing.assert_array_equal(arrays["pred_rel"], arrays["traj_rel"][:, [2, 2]])
        assert arrays["g_state/w"].tolist() == [1, 1, 1]
    with pytest.raises(InputError, match="already there"):
        run(Options(checkout, out))


def test_what_is_wrong_is_one_line(checkout, tmp_path):
    for options, reason in (
        (Options(tmp_path, tmp_path / "out"), "has no sgan/models.py"),
        (Options(checkout, tmp_path / "out", (tmp_path / "no.pt",)), "no such checkpoint"),
        (Options(checkout, tmp_path / "out", python="nowhere"), "--python nowhere: No such file"),
        (Options(checkout, tmp_path / "out"), "SGAN's code failed: AssertionError"),
    ):
        with pytest.raises(InputError, match=reason) as error:
            run(options)
        assert "\n" not in str(error.value)
        assert not (tmp_path / "out").exists()


def test_the_script_is_of_an_old_python_too():
    script = Path(run.__code__.co_filename).parents[1] / "interop" / "torch_side.py"
    code = f"import ast; ast.parse(open({str(script)!r}).read(), feature_version=(3, 7))"
    subprocess.run([sys.executable, "-c", code], check=True)
