"""`lookback eval`: how well a map is recognized in your recordings. `lookback dev golden`: a recording as a test."""
