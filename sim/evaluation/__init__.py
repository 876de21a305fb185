"""`lookback eval`: how well a map is recognized in your recordings."""
