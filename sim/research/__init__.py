"""What was measured to build Lookback, and how: not in the wheel, run from a clone.

evaluation  the place belief: on other roads, at any spacing, by light
trial       `lookback dev gps`, `flights` and `ablate`: errors of GPS; recorded drives anew, and without each rule
alexnet     `lookback dev alexnet`: networks from weights of AlexNet, as the shipped one was made
bench       `make bench`: what each stage costs
"""
