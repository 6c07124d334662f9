"""A whisker swept over an object (§2g): its contacts, and how they are followed from moments.

`sweep` computes where a whisker touches a `peg`, a `cylinder` or a `wall` as its base turns or
moves; `follow` recovers the path of the contact from the moment and the push angle.
"""

from .objects import Body, cylinder, peg, wall
from .quasi_static import Sweep, sweep
from .track import Track, follow

__all__ = ["Body", "Sweep", "Track", "cylinder", "follow", "peg", "sweep", "wall"]
