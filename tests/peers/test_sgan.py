"""SGAN's own evaluation of a published network, and ours of the samples that it drew."""

import runpy

import numpy as np
import pytest

import neurosym_jax as nj
from benchmarks.original import Arguments, folder_of, load_script
from tests.repository import ROOT


@pytest.mark.parametrize("name", ["sgan-models/zara1_8", "sgan-p-models/hotel_8"])
def test_its_evaluation_agrees_to_six_digits(peer, shared, tmp_path, monkeypatch, name):
    torch = pytest.importorskip("torch")
    script = load_script(peer("sgan") / "sgan", "evaluate_model")
    dataset = {"zara1": "crowds_zara01", "hotel": "biwi_hotel"}[name.split("/")[1][:-2]]
    recording = shared / f"data/eth_ucy/all/{dataset}.txt"
    checkpoint = torch.load(shared / f"checkpoints/{name}_model.pt", map_location="cpu")
    drawn = []

    def recorded(steps, start, absolute=script.relative_to_abs):
        drawn.append(absolute(steps, start))
        return drawn[-1]

    monkeypatch.setattr(script, "relative_to_abs", recorded)
    torch.manual_seed(0)
    args = Arguments(checkpoint["args"] | {"loader_num_workers": 0})
    with folder_of([recording]) as folder:
        data, loader = script.data_loader(args, folder)
    # Its own loader shuffles. A batch has several scenes, and is forecast k times.
    size, unite = args.batch_size, loader.collate_fn
    ordered = torch.utils.data.DataLoader(data, size, collate_fn=unite)
    errors = script.evaluate(args, ordered, script.get_generator(checkpoint), 20)
    sizes, scenes = np.diff(np.array(data.seq_start_end)).ravel(), []
    for batch in range(0, len(sizes), size):
        samples = np.stack([drawn.pop(0).numpy() for _ in range(20)]).transpose(
            0, 2, 1, 3
        )
        scenes += np.split(samples, sizes[batch : batch + size].cumsum()[:-1], axis=1)
    adapters = runpy.run_path(str(ROOT / "examples/peer_forecasts.py"))
    np.savez(tmp_path / "theirs.npz", **adapters["in_loader_order"](scenes, recording))
    (row,) = nj.evaluate(
        (), recording, forecasts=tmp_path / "theirs.npz", baselines=[]
    ).iter_rows(named=True)
    ours = [row["joint_ade"], row["joint_fde"]]
    theirs = [float(error) for error in errors]
    print(name, *(f"{error:.6f}" for error in [*theirs, *ours]))
    np.testing.assert_allclose(theirs, ours, atol=2e-6)
