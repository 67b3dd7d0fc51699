from .following import NearestIds as NearestIds
from .stitching import LinkOptions as LinkOptions
from .stitching import OnlineStitcher as OnlineStitcher
from .stitching import Stitched as Stitched
from .stitching import idf1 as idf1
from .stitching import stitch as stitch
