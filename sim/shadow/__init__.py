"""What a journal of drives beside GPS says: where positions would have been good enough, and where not.

`drives`   the records of each drive: errors against GPS, and for how many meters nothing came
`road`     the stretches of road that were driven, by where GPS had the vehicle
`sun`      the light, by clock and position
`judging`  how true the standard deviations are, and whether a stretch is ready
"""
