"""QSRlib's own unit tests of QTC, answered by our symbols through an adapter."""

import importlib
import itertools
import sys
import types
import unittest
from collections import defaultdict
from typing import Any, NamedTuple

import jax
import numpy as np
import pytest

from neurosym_jax.symbolic import collapse, format_state, observe, validate

CALCULI: dict[str, Any] = {"qtcbs": "b1", "qtccs": "c1", "qtcbcs": "bc1"}
DEFAULTS = {
    "quantisation_factor": 0.0,
    "validate": True,
    "no_collapse": False,
    "distance_threshold": 1.22,
}


class Request(NamedTuple):
    """What its tests ask for."""

    which_qsr: str
    input_data: Any
    dynamic_args: Any = None


class Adapter:
    """In place of its `QSRlib`: it asks us for the states of each pair."""

    def request_qsrs(self, request):
        name, arguments = request.which_qsr, request.dynamic_args or {}
        own, everywhere = arguments.get(name, {}), arguments.get("for_all_qsrs", {})
        options = DEFAULTS | own
        tracks, times = defaultdict(list), request.input_data.get_sorted_timestamps()
        for time in times:
            for person, state in request.input_data.trace[time].objects.items():
                tracks[person].append((state.x, state.y))
        people = sorted(tracks)
        pairs = list(itertools.permutations(people, 2))
        pairs = own.get("qsrs_for", everywhere.get("qsrs_for", pairs))
        trace = defaultdict(dict)
        for pair in pairs:
            first, second = (np.array(tracks[person]) for person in pair)
            texts = states_of(first, second, name, options)
            numbers = range(1, len(texts) + 1)
            # States keep their times if none is left out or put between.
            if options["no_collapse"] and not options["validate"]:
                numbers = times[1:]
            for number, text in zip(numbers, texts, strict=True):
                value = types.SimpleNamespace(qsr={name: text})
                trace[number][",".join(pair)] = value
        return types.SimpleNamespace(qsrs=Trace(trace))


class Trace:
    """States by time and pair, as its tests read them."""

    def __init__(self, states):
        self.trace = {t: types.SimpleNamespace(qsrs=s) for t, s in states.items()}

    def get_sorted_timestamps(self):
        return sorted(self.trace)


def states_of(first, second, name, options):
    """Our states of a pair by its options, as its texts."""
    states = observe(
        first,
        second,
        CALCULI[name],
        convention="line",
        quantisation_factor=options["quantisation_factor"],
        near=options["distance_threshold"],
    )
    if not options["no_collapse"]:
        states = collapse(states)
    if options["validate"]:
        states = validate(states)
    return [format_state(state, ",") for state in states]


@pytest.mark.parametrize("name", CALCULI)
def test_its_unit_tests_pass(peer, monkeypatch, name):
    library = peer("strands_qsr_lib") / "strands_qsr_lib/qsr_lib"
    for folder in ("src", "tests"):
        monkeypatch.syspath_prepend(str(library / folder))
    modules = {
        "qsrlib.qsrlib": {"QSRlib": Adapter, "QSRlib_Request_Message": Request},
        "roslib.packages": {
            "find_resource": lambda _, file: [str(library / "tests/data" / file)]
        },
    }
    for module_name, values in modules.items():
        module = types.ModuleType(module_name)
        vars(module).update(values)
        monkeypatch.setitem(sys.modules, module_name, module)
    monkeypatch.setattr(
        unittest.TestCase,
        "assertItemsEqual",
        unittest.TestCase.assertCountEqual,
        raising=False,
    )
    module = importlib.import_module(f"{name}_tester")
    suite = unittest.TestLoader().loadTestsFromModule(module)
    with jax.enable_x64(True):
        result = unittest.TextTestRunner().run(suite)
    assert result.testsRun >= 5
    assert result.wasSuccessful(), result.failures + result.errors
