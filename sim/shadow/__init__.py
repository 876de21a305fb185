"""What a journal of drives beside GPS says: where positions would have been good enough, and where not.

`drives`   the records of each drive: errors against GPS, for how many meters nothing came, and the light by the sun
`judging`  the stretches of road that were driven, how true the standard deviations are, and whether a stretch is ready
"""
