"""`lookback sim fixes`: does what the daemon tells an autopilot do it good? Seeded drives, judged by the truth.

course  worlds driven once with a camera, and for each run a map of ten stretches with a false one planted among them
run     one drive: the whole daemon and the simulated autopilot on a pty, in simulated time
score   how far the autopilot was off after each fix, how honest the sigmas were, whether the false place got out
command prints a line for each run and the table over all
"""
