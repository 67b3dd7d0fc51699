from .bags import BagWriter as BagWriter
from .bags import read_frames as read_frames
from .bags import read_people as read_people
from .messages import forecast_message as forecast_message
from .messages import make_people as make_people
from .messages import truth_message as truth_message
from .people import see as see
