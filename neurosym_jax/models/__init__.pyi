from .discriminator import Discriminator as Discriminator
from .generator import Generator as Generator
from .poolings import register_pooling as register_pooling
