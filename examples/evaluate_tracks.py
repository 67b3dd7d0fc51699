"""From a file of tracks to a table of errors, with models that ship.

python examples/evaluate_tracks.py TRACKS MODEL [MODEL ...]
"""

import sys

import neurosym_jax as nj

tracks, *names = sys.argv[1:]
models = [nj.load_model(name) for name in names]
rows = nj.evaluate(models, nj.data.read_any(tracks))
print(nj.evaluation.format_table(rows))
