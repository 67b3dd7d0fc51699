"""AgentFormer's own evaluation of forecasts in its layout, and ours: the same errors."""

import re
import runpy

import numpy as np
import pytest

import neurosym_jax as nj
from neurosym_jax.data import cut_windows
from neurosym_jax.data.recordings import recordings_in
from neurosym_jax.evaluation.forecasts import last_frames
from neurosym_jax.models.forecast import predict_scenes
from tests.repository import ROOT

SEQUENCE = "crowds_zara01"
LENGTHS = {"obs_len": 8, "pred_len": 12}


@pytest.mark.parametrize("name", ["sgan_zara1_12", "anchors_zara1_12"])
def test_its_evaluation_agrees_to_four_digits(
    peer, tmp_path, monkeypatch, capsys, name
):
    pytest.importorskip("torch")  # Before its code imports it.
    folder = peer("AgentFormer") / "AgentFormer"
    table = np.loadtxt(
        folder / f"datasets/eth_ucy/zara1/{SEQUENCE}.txt",
        usecols=(0, 1, 13, 15),
        dtype=float,
    )
    recording = tmp_path / f"{SEQUENCE}.txt"
    np.savetxt(recording, table, fmt=["%d", "%d", "%.9f", "%.9f"])
    windows = cut_windows(recordings_in(recording), min_agents=1, **LENGTHS)
    numbers = range(0, windows.scenes, 20)
    scenes = [windows.rows(np.array([number])) for number in numbers]
    forecasts = predict_scenes(
        nj.load_model(name), [windows.position[rows, :8] for rows in scenes]
    )
    for rows, forecast, frame in zip(
        scenes, forecasts, last_frames(windows)[list(numbers)]
    ):
        moment = tmp_path / f"{SEQUENCE}/frame_{int(frame):06d}"
        moment.mkdir(parents=True)
        for number, sample in enumerate(forecast):
            lines = []
            for person, path in zip(windows.agent[rows], sample):
                for step, xy in enumerate(path):
                    lines.append((frame + 1 + step, person, *xy))
            np.savetxt(moment / f"sample_{number:03d}.txt", lines, fmt="%.6f")
    monkeypatch.chdir(folder)
    argv = ["eval.py", "--dataset", "zara1", "--results_dir", str(tmp_path)]
    monkeypatch.setattr("sys.argv", [*argv, "--log_file", str(tmp_path / "log.txt")])
    runpy.run_path("eval.py", run_name="__main__")
    capsys.readouterr()
    said = re.findall(
        r"^(\d+) .DE: ([\d.]+)$", (tmp_path / "log.txt").read_text(), re.MULTILINE
    )
    adapters = runpy.run_path(str(ROOT / "examples/peer_forecasts.py"))
    np.savez(tmp_path / "theirs.npz", **adapters["agentformer"](tmp_path / SEQUENCE))
    (row,) = nj.evaluate(
        (),
        recording,
        forecasts=tmp_path / "theirs.npz",
        baselines=[],
        min_agents=1,
        partial=True,
    ).iter_rows(named=True)
    ours = [row["marginal_ade"], row["marginal_fde"]]
    print(name, *(error for _, error in said), *(f"{error:.6f}" for error in ours))
    assert [int(count) for count, _ in said] == [row["agents"]] * 2
    np.testing.assert_allclose([float(error) for _, error in said], ours, atol=5.1e-5)
