"""`lookback calibrate`: the camera, the rig's offset and the acceptance threshold, measured on recorded drives.

camera     a recorded drive: its field of view and k1, by successive pictures
sightings  a recorded drive with positions through the recognizer: for each match, how far ahead the place lies
offset     from sightings: the rig's along-route offset for each direction and region order, and the error that remains
threshold  from sightings, or from the map alone: the confidence from which a place is believed
command    prints the lines for the config, and writes them into it
"""
