from .discriminator import Discriminator as Discriminator
from .generator import Generator as Generator
from .pooling import Pooling as Pooling
from .pooling import pooling_names as pooling_names
from .pooling import register_pooling as register_pooling
