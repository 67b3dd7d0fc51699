from .checkpoint import export_torch_checkpoint as export_torch_checkpoint
from .checkpoint import load_torch_checkpoint as load_torch_checkpoint
from .export import export_model as export_model
from .hub import from_pretrained as from_pretrained
from .hub import push_to_hub as push_to_hub
from .parity import Parity as Parity
from .parity import compare as compare
from .parity import run_parity as run_parity
