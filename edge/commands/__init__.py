"""The commands of `lookback`, one module each: `add_command` puts it on the command line."""
