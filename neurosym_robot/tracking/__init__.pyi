from .identity import idf1 as idf1
from .linking import LinkOptions as LinkOptions
from .live import OnlineStitcher as OnlineStitcher
from .nearest import NearestIds as NearestIds
from .stitching import Stitched as Stitched
from .stitching import stitch as stitch
