"""`lookback home`: print the way home, write it to a file, upload it, or have the running daemon do so."""
