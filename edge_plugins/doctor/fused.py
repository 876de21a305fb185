"""What `lookback doctor` says of an ArduPilot's parameters for poses that its filter fuses, and what each value costs.

The values are those of firmware_config/ardupilot_*_fused.param, which say where the figures are from.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Set

from edge.telemetry.firmware import AIRSPEED, FLOW, WHEELS
from edge_plugins.doctor.findings import Found, bad, good, note

RESETS = "each pose resets its position: with wheels 3 % wrong 2.2 m off in the median, 5.1 at most; fused, 0.5 and 2.1"
CHOICE: Mapping[str, tuple[float, str]] = {"VISO_TYPE": (1.0, RESETS), "EK3_SRC2_POSXY": (6.0, RESETS)}
"""Value and cost of those by which poses are fused in the set that Lookback selects without GPS; by parameter."""
REST: Mapping[str, tuple[float, str]] = {
    "EK3_SRC2_VELXY": (0.0, "between poses nothing measures its velocity, and the filter stops aiding within 15 s"),
    "EK3_SRC2_VELZ": (0.0, "3 is GPS, which is lost or wrong then; a pose (6) has no velocity"),
    "EK3_SRC2_POSZ": (1.0, "3 is GPS, which is lost or wrong then; the height of a pose (6) is the filter's own"),
    "EK3_SRC2_YAW": (1.0, "without the compass, each degree of its heading is 1.7 m beside the lane after 100 m"),
    "VISO_POS_M_NSE": (0.1, "a pose, 0.35 m uncertain in the median, counts as this uncertain at least"),
    "VISO_DELAY_MS": (10.0, "each 100 ms away from it are 0.5 m along-track at 5 m/s"),
    "EK3_WENC_VERR": (1.0, "with 0.1, wheels 3 % wrong are 2.2 m off in the median, 6.7 at most; with 1, 0.5 and 2.1"),
}
SOURCES = {WHEELS: (7.0, "rover"), FLOW: (5.0, "copter"), AIRSPEED: (0.0, "plane")}
"""By what measures its velocity without GPS: EK3_SRC2_VELXY, and the vehicle of the file."""


def wanted(values: Mapping[str, float]) -> Set[str]:
    """Which parameters are judged, by those that are known."""
    return {*CHOICE, *REST} if _is_chosen(values) else CHOICE.keys()


def judge(values: Mapping[str, float], aid: str | None) -> Iterator[Found]:
    """Each value that is not as in the file for that vehicle, with its cost. aid: see `velocity_aid`."""
    if aid not in SOURCES or not CHOICE.keys() <= values.keys():
        return
    velocity, kind = SOURCES[aid]
    is_chosen, judged = _is_chosen(values), CHOICE
    if is_chosen:
        judged = {**REST, "EK3_SRC2_VELXY": (velocity, REST["EK3_SRC2_VELXY"][1])}
        yield good("keypoint poses are fused while GPS is lost or faulty, in source set 2")
    for name, (value, cost) in judged.items():
        is_of_it = name in values and (aid == WHEELS or name != "EK3_WENC_VERR")
        if is_of_it and abs(values[name] - value) > 1e-3:
            found = bad if is_chosen and name.startswith("EK3_") else note
            yield found(
                f"{name} = {values[name]:g}: {cost}",
                f"set it to {value:g}, as firmware_config/ardupilot_{kind}_fused.param does",
            )


def _is_chosen(values: Mapping[str, float]) -> bool:
    return all(values.get(name) == value for name, (value, _) in CHOICE.items())
