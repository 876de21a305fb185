"""A drive in simulated time: the daemon beside a simulated autopilot. `sim.research.trial` has the courses.

way         where a drive truly goes, what the camera sees there, and who drives: a person, or the autopilot
views       what is seen, as descriptors, rendered once; and the cameras
draft       a drive before it is driven: way, vehicle, and where GPS fails; the demo's
simulation  vehicle, autopilot and camera, in simulated time
run         one drive: the daemon beside them, and what it was worth
records     what it was worth, by the truth, beside the same drive without Lookback
"""
