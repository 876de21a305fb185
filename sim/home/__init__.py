"""`lookback home`: print the way home, or write it to a file."""
