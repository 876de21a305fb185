"""`lookback home`: print the way home, write it to a file, or upload it."""
