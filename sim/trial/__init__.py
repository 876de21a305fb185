"""`lookback sim fixes`: do the daemon's fixes improve the autopilot's position? Seeded drives, judged by the truth.

course   roads recorded once in each direction, and for each run a map of ten stretches with a false one among them
run      one drive: the daemon beside a simulated autopilot, in simulated or in real time
score    the autopilot's error after each fix, error over sigma, and whether a fix of the false stretch was sent
command  prints a line for each run, and the table of all
"""
