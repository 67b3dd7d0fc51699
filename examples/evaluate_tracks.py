"""From a file of tracks to errors, with a model that ships.

python examples/evaluate_tracks.py TRACKS MODEL
"""

import sys

import neurosym_jax as nj

tracks, name = sys.argv[1:]
model = nj.load_model(name)
windows = nj.data.windows_from(tracks, model.config.obs_len, model.config.pred_len)
batches = nj.data.make_batches(windows)
found = nj.evaluation.score_forecaster(model.forecaster, model.params, batches, samples=20, seed=0)
print(f"ADE {found.mean('joint_ade'):.3f} m, FDE {found.mean('joint_fde'):.3f} m")
