"""The state of the daemon: `health` decides it, `monitor` publishes it, and `service` is the link to systemd."""
