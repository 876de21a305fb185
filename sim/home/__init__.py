"""`lookback home` and `lookback route`: print a way along drives of a map, or write it to a file."""
