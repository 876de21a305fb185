"""Frames become a feed: `recorder` writes it by a thread, for the daemon and for `lookback record` (`command`)."""
