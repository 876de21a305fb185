"""`lookback try`: from two recordings to a verdict in one command.

command  imports, builds the map, measures the camera's offset, replays, and prints the closing lines
verdict  of a recognition: where it was not recognized, why, and what to change; pure functions
page     the same as one HTML page
"""
