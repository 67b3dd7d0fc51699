from .scenarios import Scenario as Scenario
from .scenarios import simulate as simulate
from .scenarios import synthetic_tracks as synthetic_tracks
from .tracker import TrackerFaults as TrackerFaults
from .tracker import track as track
