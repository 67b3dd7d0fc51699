from .forecasts import plot_forecasts as plot_forecasts
from .forecasts import plot_horizon_errors as plot_horizon_errors
from .style import PALETTE as PALETTE
from .style import model_looks as model_looks
from .style import save_figure as save_figure
from .symbols import plot_pairs as plot_pairs
from .tracks import plot_tracks as plot_tracks
from .training import plot_training as plot_training
