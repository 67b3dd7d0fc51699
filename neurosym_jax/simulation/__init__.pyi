from .scenarios import Scenario as Scenario
from .scenarios import TrackerFaults as TrackerFaults
from .scenarios import simulate as simulate
