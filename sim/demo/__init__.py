"""`lookback demo`: the main job in simulation, from the first map to an autopilot that receives place fixes.

command   the steps, in order, and what is printed; the drives are those of `sim.vehicle.daemon_drive`
review    the frames that the daemon used, rendered and recognized again, for the report
report    one self-contained HTML page
pictures  the README's pictures, of the same run
"""
