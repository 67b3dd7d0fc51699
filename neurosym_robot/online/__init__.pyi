from .analytics import Analytics as Analytics
from .frames import Frame as Frame
from .frames import frames_of_tracks as frames_of_tracks
from .frames import tracks_of_frames as tracks_of_frames
from .predictor import Forecast as Forecast
from .predictor import ModelForecast as ModelForecast
from .predictor import Predictor as Predictor
from .replay import ReplayEvent as ReplayEvent
