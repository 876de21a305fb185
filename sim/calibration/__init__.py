"""`lookback calibrate`: the camera, the rig's offset, the acceptance threshold and the wheels, measured on drives.

camera     a recorded drive: its field of view and k1, by successive pictures
samples    a recorded drive with positions through the recognizer: for each match, how far ahead the place lies
offset     from samples: the rig's along-track offset for each direction and region order, and the error that remains
threshold  from samples: the confidence from which a place is believed
wheels     the drives of `lookback run` beside GPS: the radius of the autopilot's wheels, which is set on request
command    prints the lines for the config, and writes them into it
"""
