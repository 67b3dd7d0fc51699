import json

import pytest
from numpy.testing import assert_allclose

from neurosym_jax.data.readers.trajnet import read_trajnet
from neurosym_jax.errors import InputError


def test_frames_that_step_by_ten(tmp_path):
    points = [{"track": {"f": 10 * f, "p": 1, "x": f, "y": 0}} for f in range(3)]
    scene = {"scene": {"id": 1, "p": 1, "s": 0, "e": 20, "fps": 2.5}}
    path = tmp_path / "a.ndjson"
    path.write_text("\n".join(map(json.dumps, [scene, *points])))
    assert_allclose(read_trajnet(path).stamp, [0, 0.4, 0.8])
    assert_allclose(read_trajnet(path, stride=5).stamp, [0, 0.8, 1.6])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file has no track rows"),
        ('{"track": {"f": 1', "row 1 is not JSON"),
        ("[1]", "row 1 is neither a track nor a scene"),
        ('{"track": {"f": 1, "p": 1, "x": 0}}', "row 1: y is 'None', not a usable number"),
        ('{"track": {"f": 1.5, "p": 1, "x": 0, "y": 0}}', "row 1: f 1.5 is not a whole"),
        ('{"track": {"f": 1, "p": 1, "x": NaN, "y": 0}}', "row 1 is not JSON .NaN is not"),
        ('{"track": {"f": 1, "p": 1, "x": 1e12, "y": 0}}', "row 1: position"),
        ('{"scene": {"id": 1, "p": 1, "s": 0, "e": 1, "fps": 0}}', "row 1: fps is 0"),
        ('{"track": {"f": 1, "p": 1, "x": 1, "y": 0}}\n' * 2, "row 2 repeats"),
        ('{"track": {"f": 1' + "0" * 5000 + "}}", "row 1 is not JSON"),
    ],
)
def test_bad_files(tmp_path, text, message):
    path = tmp_path / "a.ndjson"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_trajnet(path)
