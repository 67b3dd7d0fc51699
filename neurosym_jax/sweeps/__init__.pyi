from .comparison import Comparison as Comparison
from .comparison import compare as compare
from .errors import read_sweep as read_sweep
from .report import write_report as write_report
from .runs import SweepRun as SweepRun
from .runs import plan_runs as plan_runs
from .sweep import run_sweep as run_sweep
