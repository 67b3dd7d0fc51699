"""The six situations are what they say, and stitching is worth something in each."""

import numpy as np
import pytest

from neurosym_robot.tracking.stitching import LinkOptions, idf1
from studies.stitching.__main__ import offline, online
from studies.stitching.peers import greedy
from studies.stitching.situations import SITUATIONS


@pytest.mark.parametrize("name", SITUATIONS)
def test_stitching_is_not_behind(name):
    tracks, person = SITUATIONS[name](1)
    raw = idf1(person, tracks.id)
    peer = idf1(person, greedy(tracks, LinkOptions()))
    for ids_of in (offline, online):
        score = idf1(person, ids_of(tracks))
        assert score > raw
        assert score > peer - 0.05
    assert (person == -1).any() == (name == "ghosts")
    assert len(np.unique(tracks.id)) > len(np.unique(person)) or name == "swaps"
