"""Statistics of the trial: GPS that is wrong or honest, and recorded drives with the daemon of today."""
