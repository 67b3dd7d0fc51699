"""Forecast a recording frame by frame, as a robot would live.

python examples/forecast_frames.py TRACKS MODEL
"""

import sys

import neurosym_jax as nj
import neurosym_robot as robot

tracks, name = sys.argv[1:]
predictor = robot.Predictor(nj.load_model(name))
(recording,) = nj.data.read_any(tracks)
for stamp, ids, xy in robot.frames_of_tracks(recording):
    forecast = predictor.push(stamp, ids, xy)
    # None for a frame that is refused; of nobody until somebody is seen long enough.
    if forecast is not None and len(forecast.ids):
        (model,) = forecast.models.values()
        print(
            f"{stamp:.1f} s: {len(forecast.ids)} people, samples {model.samples.shape}"
        )
