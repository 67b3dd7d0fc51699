"""Train NeuroSyM on simulated people, and score it on those that were kept back.

python examples/train_model.py FOLDER STEPS
"""

import sys

import neurosym_jax as nj

folder, steps = sys.argv[1:]
source = nj.data.Synthetic()
training, validation, test = (
    source.recordings("cross-path", part) for part in ("train", "val", "test")
)
config = nj.training.make_config("neurosym", changes=["weighting=quantised"])
recipe = nj.training.make_recipe("ours", steps=int(steps), changes=["batch_scenes=16"])
model = nj.train(training, validation, folder, config=config, recipe=recipe)
batches = nj.data.make_batches(nj.data.windows_from(test, 8, 8))
score = nj.evaluation.score_forecaster(
    model.forecaster, model.params, batches, samples=20, seed=0
)
print(f"ADE {score.mean('joint_ade'):.3f} m, FDE {score.mean('joint_fde'):.3f} m")
