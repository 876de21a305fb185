"""`lookback doctor`: a table of checks of the config, the computer, the set-up and the autopilot."""
