from .bag_writer import BagWriter as BagWriter
from .bags import read_frames as read_frames
from .bags import read_people as read_people
from .messages import make_people as make_people
from .people import see as see
from .trajectories import forecast_message as forecast_message
from .trajectories import truth_message as truth_message
