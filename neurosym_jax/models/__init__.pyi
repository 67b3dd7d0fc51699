from .discriminator import Discriminator as Discriminator
from .generator import Generator as Generator
