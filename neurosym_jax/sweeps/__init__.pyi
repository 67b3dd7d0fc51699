from .comparison import Comparison as Comparison
from .comparison import compare as compare
from .errors import read_sweep as read_sweep
from .runs import SweepRun as SweepRun
from .runs import plan_runs as plan_runs
