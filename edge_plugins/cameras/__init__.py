"""Cameras of an extra: `oak`, `stream`, and `command_output`, which a stream may come from."""
