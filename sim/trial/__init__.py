"""A drive in simulated time: the daemon beside a simulated autopilot. `sim.research.trial` has the courses.

way           where a drive truly goes, and what the camera sees there
driver        who drives it: a person, or the autopilot by what it believes
views         what is seen, as descriptors, rendered once
draft         a drive before it is driven: way, vehicle, and where GPS fails
take_me_home  the demo's drive
simulation    vehicle, autopilot and camera, in simulated time
run           one drive: the daemon beside them, and what it was worth
records       what it was worth, by the truth, beside the same drive without Lookback
"""
