import numpy as np

from neurosym_jax.data.formats import read_any
from studies.more_data import HERMES, KEPT_BACK, STANFORD, STANFORD_TESTED, write
from studies.weighting.data import LEARNED, TESTED


def test_what_is_kept_back_is_not_read_and_tests_are_not_trained_on(tmp_path):
    opentraj, out = tmp_path / "opentraj", tmp_path / "out"
    for folder in (STANFORD, HERMES):
        (opentraj / folder).mkdir(parents=True)
    for name in (*KEPT_BACK, *STANFORD_TESTED, "gates_0"):
        (opentraj / STANFORD / f"{name}.txt").write_text("0 1 0 0\n12 1 0.5 0\n")
    walk = [(1, frame, 100 + 10 * frame, 50, 0) for frame in range(64)]
    for name in (*LEARNED, *TESTED, "boa-300-050-070"):
        np.savetxt(opentraj / HERMES / f"{name}.txt", walk)
    write(opentraj, out)
    found = {folder.name: {path.stem for path in folder.iterdir()} for folder in out.iterdir()}
    assert found == {
        "stanford": {"gates_0"},
        "hermes": set(LEARNED),
        "tests": {*TESTED, *STANFORD_TESTED},
    }
    # 16 frames of 10 cm a second are 0.64 m in 0.4 s.
    walked = read_any(out / "hermes" / f"{LEARNED[0]}.txt")[0].position
    np.testing.assert_allclose(np.diff(walked[:, 0]), 0.64, atol=1e-4)
