"""The commands of `lookback`, one module each; `parser` puts them on one command line."""
