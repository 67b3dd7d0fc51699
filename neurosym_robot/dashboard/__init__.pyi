from .dashboard import Dashboard as Dashboard
from .dashboard import ReplayFile as ReplayFile
from .dashboard import View as View
