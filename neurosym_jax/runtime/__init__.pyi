from .process import enable_compilation_cache as enable_compilation_cache
from .process import run_environment as run_environment
from .process import tune as tune
