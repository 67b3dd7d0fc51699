from . import dashboard as dashboard
from . import online as online
from . import ros as ros
from . import tracking as tracking
from .online.predictor import Predictor as Predictor
