from .dashboard import Dashboard as Dashboard
from .replay_file import ReplayFile as ReplayFile
from .replay_file import write_replay as write_replay
