"""The live page: `server` is the thread, `snapshot` what it shows."""
