"""The flight mode that PX4 is in: the chosen one, or what it falls back to while it has no position.

Position falls back to Altitude, whatever the vehicle is (`checkModeFallback` in commander/failsafe/failsafe.cpp of PX4
1.17 and 1.18; PX4#28108 is about rovers), a mode that drives itself to Descend. Each comes back with the position, as
Hold was recorded to do on 1.18.
"""

from __future__ import annotations

from typing import Literal, TypeAlias

FlightMode: TypeAlias = Literal["manual", "altitude", "position", "stabilized", "hold", "mission", "descend"]
MODES: dict[FlightMode, tuple[int, int]] = {
    "manual": (1, 0),
    "altitude": (2, 0),
    "position": (3, 0),
    "stabilized": (7, 0),
    "hold": (4, 3),
    "mission": (4, 4),
    "descend": (4, 6),
}
"""Main mode and sub mode, as `custom_mode` of the heartbeat has them."""
WITHOUT_POSITION: dict[FlightMode, FlightMode] = {"position": "altitude", "hold": "descend", "mission": "descend"}
NO_AID_TIMEOUT = "EKF2_NOAID_TOUT"
NO_AID_US = 5_000_000
"""As shipped: microseconds after the last measurement of position or velocity until there is no position."""


def custom_mode(chosen: FlightMode | None, unaided_s: float, timeout_us: float = NO_AID_US) -> int:
    """Of the heartbeat, 0 where no mode was chosen. unaided_s: since position or velocity was measured last."""
    if chosen is None:
        return 0
    mode = WITHOUT_POSITION.get(chosen, chosen) if unaided_s * 1e6 > timeout_us else chosen
    main, sub = MODES[mode]
    return main << 16 | sub << 24
