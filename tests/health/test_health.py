"""Which state follows from what the parts say, and that every state has a heartbeat of its own."""

from __future__ import annotations

from dataclasses import replace

import pytest

from edge.health.health import MAV_STATES, STARTING, Health, HealthInputs, derive

WELL = HealthInputs(recognizer="on the map", frames_used=50)


@pytest.mark.parametrize(
    ("changes", "state", "why"),
    [
        ({}, "on the map", ""),
        ({"recognizer": "off the map"}, "off the map", "not recognized"),
        ({"recognizer": "off the map", "off_m": 120.0}, "off the map", "not recognized for 100 m"),
        ({"recognizer": "warming up"}, "warming up", "more frames are needed"),
        ({"recognizer": "searching"}, "warming up", "the whole map is searched"),
        ({"frames_used": 0}, "starting", "no picture has been used yet"),
        ({"frames_used": 0, "camera": "opening"}, "starting", "no picture has been used yet"),
        ({"withheld": "GPS is healthy"}, "on the map", "no position: GPS is healthy"),
        ({"no_pose_m": 99.0, "right_m": -4.2}, "on the map", "no pose for 40 m, before 4.2 m left of the map's lane"),
        (
            {"recognizer": "off the map", "off_m": 60.0, "journal": "x", "no_pose_m": 100.0, "right_m": 0.3},
            "degraded",
            "journal: x; off the map: not recognized for 50 m; no pose for 100 m, before 0.3 m right of the map's lane",
        ),
        ({"camera": "ended"}, "on the map", ""),
        ({"camera": "lost", "camera_why": "no frame"}, "degraded", "not recognized: camera: no frame"),
        ({"picture": "the image is frozen"}, "degraded", "not recognized: camera: the image is frozen"),
        ({"link": "closed", "link_why": "ttyX: gone"}, "degraded", "link: ttyX: gone; on the map"),
        ({"link": "waiting", "link_down_s": 4.0}, "on the map", ""),
        ({"link": "waiting", "link_down_s": 6.0}, "degraded", "link: no autopilot heard; on the map"),
        ({"journal": "no space left"}, "degraded", "journal: no space left; on the map"),
        ({"frame_s": 1.5}, "degraded", "slow: a frame took over 1 s; on the map"),
        (
            {"camera": "lost", "camera_why": "x", "journal": "y"},
            "degraded",
            "not recognized: camera: x; journal: y",
        ),
    ],
)
def test_states(changes: dict[str, object], state: str, why: str) -> None:
    health = derive(replace(WELL, **changes))  # type: ignore[arg-type]
    assert (health.state, health.why) == (state, why)


def test_a_standing_vehicle_keeps_its_state() -> None:
    standing = replace(WELL, recognizer="standing")
    assert derive(standing, derive(WELL)).state == "on the map"
    assert derive(standing, derive(replace(WELL, recognizer="off the map"))).state == "off the map"
    assert derive(standing, STARTING).state == "warming up"
    blind = derive(replace(WELL, camera="lost"))
    assert derive(replace(standing, frames_used=1), blind).state == "warming up"
    troubled = derive(replace(WELL, journal="full"))
    assert derive(standing, troubled).state == "on the map"


def test_a_camera_that_was_blind_does_not_start_anew() -> None:
    blind = derive(replace(WELL, picture="the image is covered"), derive(WELL))
    assert derive(replace(WELL, frames_used=0), blind).unable("") == "warming up"
    assert str(derive(replace(WELL, frames_used=0), blind)) == "warming up: more frames are needed"


def test_each_state_has_its_own_heartbeat() -> None:
    assert len(set(MAV_STATES.values())) == len(MAV_STATES)
    assert {Health(state).mav_state for state in MAV_STATES} == set(MAV_STATES.values())
