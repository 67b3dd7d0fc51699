from .batches import SceneStream as SceneStream
from .loop import train as train
from .loop import train_run as train_run
from .recipe import Recipe as Recipe
from .run import Run as Run
from .run import make_config as make_config
from .run import make_recipe as make_recipe
from .state import TrainState as TrainState
