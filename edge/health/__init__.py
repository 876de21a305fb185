"""The state of the daemon: `health` decides it, and `monitor` publishes it, to systemd too."""
