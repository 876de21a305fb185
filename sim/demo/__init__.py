"""`lookback demo`: the main job in simulation, from the first map to an autopilot that is told where it is.

command.py  the story, in order, and what is printed
live.py     one drive: the real daemon as its own process, a simulated autopilot at the other end of a pty
review.py   what the daemon saw, once more, for the pictures
report.py   one self-contained HTML page
pictures.py the README's pictures, of the same run
"""
