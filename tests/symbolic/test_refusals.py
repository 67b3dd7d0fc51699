"""What symbols, weightings and forecasts of them refuse, and what they say of it."""

import numpy as np
import pytest

from neurosym_jax.errors import InputError
from neurosym_jax.symbolic import adjacency, make_weighting, observe, symbolic_forecast


def forecast(**change):
    given = {"samples": np.zeros((6, 4, 5, 2)), "observed": np.zeros((4, 3, 2))}
    return symbolic_forecast(**(given | change))


@pytest.mark.parametrize(
    ("call", "given", "message"),
    [
        (observe, [[[0, 0]], [[0, 0]], "c3"], "calculus must be one of b1, c1, bc1"),
        (observe, {"k": [[0, 0]], "l": [[0, 0]], "convention": "lines"}, "convention must be one"),
        (adjacency, ["c1", "any"], "rule must be one of dominance, continuity"),
        (make_weighting, ["cdn"], r"unknown weighting 'cdn': did you mean 'cnd'\? .*shuffled"),
        (make_weighting, ["ones,learned=true"], "unknown field 'learned' for Ones"),
        (make_weighting, ["soft,temprature=0.05"], "weighting: unknown field 'temprature'"),
        (
            make_weighting,
            ["cnd,quantisation_factor=-0.1"],
            "quantisation_factor must be at least 0",
        ),
        (make_weighting, ["cnd,side_quantisation_factor=NaN"], "_factor must be a finite"),
        (make_weighting, ["soft,temperature=0"], "temperature must be positive"),
        (make_weighting, ["cnd,convention=lines"], "convention must be one of distance, line, as"),
        (make_weighting, ["quantised,quantisation_factor=0,learned=true"], "cannot be learned"),
        (forecast, {"calculus": "z9"}, "calculus must be one of b1, c1, bc1"),
        (forecast, {"speed": -1.0}, "speed must"),
        (forecast, {"sped": 1.0}, "unknown field 'sped'"),
        (forecast, {"pairs": [[0, 9]]}, "pairs must name people by 0 to 3"),
        (forecast, {"observed": np.zeros((2, 3, 2))}, r"not \[6, 4, 5, 2\] and \[2, 3, 2\]"),
    ],
)
def test_refusals(call, given, message):
    with pytest.raises(InputError, match=message):
        call(**given) if isinstance(given, dict) else call(*given)
