import json

from numpy.testing import assert_allclose

from neurosym_jax.data import ReadOptions
from neurosym_jax.data.readers.trajnet import read_trajnet


def test_frames_that_step_by_ten(tmp_path):
    points = [{"track": {"f": 10 * f, "p": 1, "x": f, "y": 0}} for f in range(3)]
    scene = {"scene": {"id": 1, "p": 1, "s": 0, "e": 20, "fps": 2.5}}
    path = tmp_path / "a.ndjson"
    path.write_text("\n".join(map(json.dumps, [scene, *points])))
    assert_allclose(read_trajnet(path).stamp, [0, 0.4, 0.8])
    assert_allclose(read_trajnet(path, ReadOptions(stride=5)).stamp, [0, 0.8, 1.6])
