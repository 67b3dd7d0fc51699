from .discriminator import Discriminator as Discriminator
from .generator import Generator as Generator
from .pooling import register_pooling as register_pooling
