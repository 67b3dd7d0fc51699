from .dashboard import Dashboard as Dashboard
from .dashboard import ReplayFile as ReplayFile
