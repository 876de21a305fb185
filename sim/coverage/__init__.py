"""What to expect of a route before departure: where a map will be recognized, and where it will not.

`passes`     drives over a map, frame by frame: believed or not; of earlier drives from their journals
`rehearsal`  drives that were never made: the map's own descriptors, changed as another light and view change them
`aliases`    stretches of a map that resemble another stretch
`sheet`      what follows for each stretch, and for the whole route
"""

from sim.coverage.aliases import Alias, aliases
from sim.coverage.passes import Pass, passes
from sim.coverage.rehearsal import Conditions, Rehearsal
from sim.coverage.sheet import Sheet, SheetSpan

__all__ = ["Alias", "Conditions", "Pass", "Rehearsal", "Sheet", "SheetSpan", "aliases", "passes"]
