"""Do the daemon's positions help, and are they honest? Drives in simulated time, judged by the truth.

way           where a drive truly goes, and what the camera sees there
views         what is seen, as descriptors, rendered once
draft         a drive before it is driven: way, map, autopilot, and what will go wrong
take_me_home  the demo's course; `sim.research.trial.courses` has all others
simulation    vehicle, autopilot and camera, in simulated time
run           one drive: the daemon beside them, its map, and what it was worth
rules         pass or fail, from truth, positions and the same drive without Lookback
"""
