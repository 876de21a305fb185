"""What was measured to build Lookback, and how: not in the wheel, run from a clone.

evaluation  the place belief on other roads, and how reliable it is
trial       `lookback dev flights` and `noises`: recorded drives anew, and how far off their measurements are
"""
