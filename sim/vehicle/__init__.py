"""A simulated vehicle on a MAVLink link: an autopilot that can be driven through the street world without hardware.

firmware         what each autopilot firmware does with a position, as a table
estimator        where the autopilot believes it is: truth with GPS, drifting odometry without
position_inputs  which positions the firmware accepts, and what they do to the estimate
mission_store    the mission, and the autopilot's side of the mission protocol
autopilot        the MAVLink endpoint: heartbeats, streams, TIMESYNC, commands; messages it encodes
pty_link         a serial cable without hardware
command          `lookback dev sim autopilot`
"""
