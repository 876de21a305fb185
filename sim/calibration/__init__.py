"""`lookback calibrate`: the two things about a vehicle that only a drive can tell.

sightings  a recorded drive with positions through the recognizer: for each answer, how far ahead the place lies
offset     from sightings: the rig's along-route offset for each direction and region order, and the error left
threshold  from sightings, or from the map against itself: the uniqueness from which matches are believed
command    prints the lines for the config, and writes them into it
"""
