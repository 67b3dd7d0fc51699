from .catalogue import make_config as make_config
from .catalogue import make_recipe as make_recipe
from .loop import train as train
from .loop import train_run as train_run
from .recipe import Recipe as Recipe
from .run import Run as Run
from .state import TrainState as TrainState
from .stream import SceneStream as SceneStream
