"""Forecasts people of a file with ONNX Runtime, without JAX: numpy and onnxruntime are enough.

neurosym export MODEL model.onnx
python examples/run_onnx.py model.onnx tracks.txt        # lines: frame id x y, metres
"""

import sys

import numpy as np
import onnxruntime


def main(model: str, tracks: str, samples: int = 20, seed: int = 0) -> np.ndarray:
    """Forecasts [k, people, pred_len, 2] metres of all who are seen in the last frames."""
    session = onnxruntime.InferenceSession(model)
    settings = session.get_modelmeta().custom_metadata_map
    inputs = {value.name: value.shape for value in session.get_inputs()}
    rows = np.loadtxt(tracks)
    frames = np.unique(rows[:, 0])[-inputs["observed"][1] :]
    rows = rows[np.isin(rows[:, 0], frames)]
    people, count = np.unique(rows[:, 1], return_counts=True)
    people = people[count == len(frames)]
    rows = rows[np.isin(rows[:, 1], people)]
    rows = rows[np.lexsort((rows[:, 0], rows[:, 1]))]
    observed = rows[:, 2:4].reshape(len(people), len(frames), 2)
    origin = observed[:, -1].mean(axis=0)  # Far from it float32 would lose millimetres.
    values = {"observed": (observed - origin).astype(np.float32)}
    if "noise" in inputs:
        rng, sizes = (
            np.random.default_rng(seed),
            {"samples": samples, "people": len(people)},
        )
        shape = [sizes.get(size, size) for size in inputs["noise"]]
        gaussian = settings["noise"] == "gaussian"
        noise = rng.normal(size=shape) if gaussian else rng.uniform(-1, 1, shape)
        values["noise"] = noise.astype(np.float32)
    forecasts, probabilities = session.run(None, values)
    best = forecasts[probabilities.argmax()] + origin
    for person, end in zip(people, best[:, -1]):
        print(f"{person:g}: in {best.shape[1]} steps at {end[0]:.2f}, {end[1]:.2f}")
    return forecasts + origin


if __name__ == "__main__":
    main(*sys.argv[1:3])
