"""The state of the daemon: `health` decides and publishes it, and `service` is the link to systemd."""
