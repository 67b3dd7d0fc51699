from .comparison import Comparison as Comparison
from .comparison import compare as compare
from .errors import read_sweep as read_sweep
