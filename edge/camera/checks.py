"""Which check the frames of a camera need, so that only a network stream loads that of a stream."""

from __future__ import annotations

from edge.camera.newest import NewestFrame
from edge.camera.picture_check import PictureCheck


def open_picture_check(device: NewestFrame | None, kind: str, min_speed_mps: float) -> PictureCheck:
    """Of a kind of [camera]; the rest as `PictureCheck`. The stamps of all other cameras are believed."""
    if kind != "stream":
        return PictureCheck(device, min_speed_mps)
    from edge.camera.picture_age import StreamCheck

    return StreamCheck(device, min_speed_mps)
