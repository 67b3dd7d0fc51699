from .parity import run_parity as run_parity
from .torch import TorchCheckpoint as TorchCheckpoint
from .torch import export_torch_checkpoint as export_torch_checkpoint
from .torch import load_torch_checkpoint as load_torch_checkpoint
