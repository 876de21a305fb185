"""The network fc6 of Lookback, a package of its own since it is for non-commercial use: files, and no code."""
