from .dashboard import Dashboard as Dashboard
from .replay_file import ReplayFile as ReplayFile
