"""The array of whiskers: where they stand and point, and where an object is from all of them.

Head coordinates, m: x to the right, y rostral, z dorsal; the origin is the mean of all base points.
The azimuth of a whisker is 0 where it points caudally, 90° to the side, 180° rostrally.
"""

from .follicles import Follicle, Published, WhiskerArray, published
from .observer import ArrayObserver
from .place import Place, place

__all__ = ["ArrayObserver", "Follicle", "Place", "Published", "WhiskerArray", "place", "published"]
