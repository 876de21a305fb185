"""All errors, in three kinds.

    LookbackError
    ├── SetupError        cannot start: invalid configuration, map, model or feed. Exit code 78, and no restart.
    │   ├── ConfigError
    │   ├── MapError
    │   ├── ModelError
    │   └── FeedError
    ├── LostError         a device or a link is gone. The daemon recovers, and reports it.
    │   ├── CameraLost
    │   └── LinkLost
    └── FrameError        one bad frame. It is dropped and counted.

Every message is one line that names the file, key or field and says what to do.
"""

import re

EXIT_SETUP = 78  # EX_CONFIG of sysexits.h; systemd's RestartPreventExitStatus names it


def reason(error: Exception) -> str:
    """What went wrong, in words: of an error of the system without its number."""
    return getattr(error, "strerror", None) or str(error)


def one_line(text: str) -> str:
    """A text in which control characters are spelled out: the name of a file must not forge a line of output."""
    return re.sub("[\x00-\x1f\x7f-\x9f\u2028\u2029]", lambda one: f"\\u{ord(one[0]):04x}", text)


class LookbackError(Exception):
    """Any error that Lookback raises on purpose; `str()` is one line for the user, or one for each argument."""

    def __str__(self) -> str:
        return "\n".join(one_line(str(line)) for line in self.args)


class SetupError(LookbackError):
    """The daemon cannot start as configured; a restart would not help."""


class ConfigError(SetupError):
    """A configuration file or an option is invalid; names the file and the key."""


class MapError(SetupError):
    """A reference map is missing, damaged, or made with another model or other regions."""


class ModelError(SetupError):
    """A network file is missing, damaged, or not one that Lookback can use."""


class FeedError(SetupError):
    """A recorded traverse is missing, damaged, or not in the feed format."""


class LostError(LookbackError):
    """A device or a link is gone."""


class CameraLost(LostError):
    """The camera stopped, was unplugged, or never answered."""


class LinkLost(LostError):
    """The MAVLink port is gone or cannot be written."""


class FrameError(LookbackError):
    """One frame could not be read; the next may be valid."""
