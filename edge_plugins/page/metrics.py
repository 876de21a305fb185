"""The status as Prometheus metrics."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from typing import get_args

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from edge.telemetry.steering import GpsUse, SteeredBy
from edge_plugins.page.snapshot import Status

STATES = ("starting", "warming up", "on the map", "off the map", "degraded", "failed")


def as_metrics(status: Status) -> bytes:
    """The text format that Prometheus scrapes."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(_OneStatus(status))
    return generate_latest(registry)


class _OneStatus(Collector):
    def __init__(self, status: Status) -> None:
        self._status = status

    def collect(self) -> Iterable[Metric]:
        return _metrics(self._status)


def _metrics(status: Status) -> Iterator[Metric]:
    camera, newest = status.camera, status.newest
    about = GaugeMetricFamily("lookback_info", "Version and map; always 1", labels=["version", "map"])
    about.add_metric([status.version, status.map_name], 1)
    yield about
    yield _gauge("start_time_seconds", "Unix time at which the daemon started", status.started_unix_s)
    yield _counter("frames_used", "Frames that went through the recognizer", status.frames_used)
    yield _counter("events", "Places that were published", status.events)
    yield _gauge("used_frames_per_second", "Rate of used frames, recently", status.fps)
    states = {state: float(state == status.state) for state in (*STATES, status.state)}
    yield _gauge("state", "1 for the current state", states, "state")
    yield _gauge("confidence_from", "Confidence from which on a place is accepted", status.confidence_from)
    if newest is not None and newest.place is not None:
        yield _gauge("uniqueness", "Uniqueness of the newest match", newest.uniqueness or 0.0)
        yield _gauge("confidence", "Confidence of the newest match", newest.confidence or 0.0)
        place = {newest.map: newest.place} if newest.map else newest.place
        yield _gauge("place", "Map row of the newest match", place, "map")
    stages = {stage: took_ms / 1e3 for stage, took_ms in status.stages_ms.items()}
    yield _gauge("stage_seconds", "Median time of a stage of a frame", stages, "stage")
    yield _gauge("camera_up", "Whether the camera delivers", float(camera.state == "running"))
    outcomes = {"delivered": camera.delivered, "overwritten": camera.overwritten, "bad": camera.bad}
    yield _counter("camera_frames", "Frames by outcome", outcomes, "outcome")
    yield _counter("camera_reopened", "How often a lost camera came back", camera.reopened)
    yield from _link_metrics(status)
    lost = "Lines that could not be written since the last one that was"
    yield _gauge("journal_lines_lost", lost, status.journal_lost)


def _link_metrics(status: Status) -> Iterator[Metric]:
    link = status.link
    yield _gauge("link_up", "Whether an autopilot is heard", float(link.state == "up"))
    yield _gauge("gps_healthy", "Whether the autopilot uses a good GPS fix", float(link.gps == "healthy"))
    is_faulty = link.gps_verdict == "faulty"
    yield _gauge("gps_faulty", "Whether GPS is declared faulty", float(is_faulty))
    yield _gauge("gps_wrong", "The old name of lookback_gps_faulty, in this version only", float(is_faulty))
    if link.gps_doubt is not None:
        # Enough evidence in one place is not declared yet: then it is rounded down, so that both metrics agree.
        doubt = 1.0 if is_faulty else min(link.gps_doubt, 0.99)
        yield _gauge("gps_doubt", "Evidence that GPS is faulty, from 0; 1 where that is declared", doubt)
    if link.gps_off_m is not None:
        yield _gauge("gps_off_meters", "How far GPS is from the places", link.gps_off_m)
    uses = {one: float(one == link.gps_use) for one in get_args(GpsUse)}
    yield _gauge("gps_use", "1 for whether the autopilot uses GPS", uses, "use")
    steered = {one: float(one == link.steers_by) for one in get_args(SteeredBy)}
    yield _gauge("steering", "1 for what the vehicle steers by", steered, "by")
    yield _counter("positions_sent", "Positions that have left for the autopilot", link.sent, "message")
    if link.confirmed_ns is not None:
        confirmed_s = (status.stamp_ns - link.confirmed_ns) / 1e9
        yield _gauge("position_confirmed_age_seconds", "Time since the autopilot agreed with one", confirmed_s)
    if link.reckoned_m is not None:
        yield _gauge("dead_reckoning_meters", "Driven since GPS or a position counted", link.reckoned_m)
    if status.beside_lane_m is not None:
        yield _gauge("beside_lane_meters", "How far right of the map's drive it is", status.beside_lane_m)
    if status.no_pose_m is not None:
        yield _gauge("no_pose_meters", "Driven since the newest keypoint pose", status.no_pose_m)
    if link.sent_ns is not None:
        age_s = (status.stamp_ns - link.sent_ns) / 1e9
        yield _gauge("position_age_seconds", "Time since the newest position left", age_s)
        both = {"along": link.level_along_m, "cross-track": link.level_cross_track_m}
        levels = {direction: math.inf if level_m is None else level_m for direction, level_m in both.items()}
        about_levels = "Of the newest position that was sent; +Inf where nothing bounds it"
        yield _gauge("protection_level_meters", about_levels, levels, "direction")


def _metric(
    kind: type[GaugeMetricFamily] | type[CounterMetricFamily],
    name: str,
    words: str,
    value: float | Mapping[str, float],
    label: str = "",
) -> Metric:
    """value: or one for each value of the label."""
    values = value if isinstance(value, Mapping) else {"": value}
    metric = kind(f"lookback_{name}", words, labels=[label] if isinstance(value, Mapping) else [])
    for key, one in values.items():
        metric.add_metric([key] if isinstance(value, Mapping) else [], one)
    return metric


_gauge, _counter = partial(_metric, GaugeMetricFamily), partial(_metric, CounterMetricFamily)
