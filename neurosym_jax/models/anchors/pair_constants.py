"""How improbable a scene is in which people overlap or companions part.

The numbers stand apart from `draws`, because a robot without JAX draws by them, too.
"""

__all__ = ["COHESION", "COMPANY", "DISTANCE", "FAR", "NEAREST", "REPULSION", "SWEEPS"]

DISTANCE = 0.3
"""Distance of two people's centres below which they overlap, metres."""
REPULSION = 8.0
"""How much less probable a scene is for each complete overlap of two people, in nats."""
COHESION = 3.0
"""How much less probable it is for two who walk together and part by `FAR`, in nats."""
FAR = 1.0
"""Root mean square change of two people's offset beyond which they have parted, metres."""
COMPANY = 1.2, 0.25
"""Distance in metres and difference of velocity in m/s at which two people hardly walk together."""
SWEEPS = 2
"""Times that each person's points are chosen anew, given everybody else's."""
NEAREST = 16
"""People on whom a person's choice depends: those who come nearest to its mean path."""
