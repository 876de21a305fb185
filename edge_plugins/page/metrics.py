"""The status as Prometheus metrics."""

from __future__ import annotations

import math
from collections.abc import Iterable

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

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
        status = self._status
        yield _gauge("info", "Version and map; always 1", {"version": status.version, "map": status.map_name}, 1)
        yield _gauge("start_time_seconds", "Unix time at which the daemon started", {}, status.started_unix_s)
        yield _counter("frames_used", "Frames that went through the recognizer", {"": status.frames_used})
        yield _counter("events", "Places that were published", {"": status.events})
        yield _gauge("used_frames_per_second", "Rate of used frames, recently", {}, status.fps)
        yield from self._recognizer(status)
        camera = status.camera
        yield _gauge("camera_up", "Whether the camera delivers", {}, float(camera.state == "running"))
        outcomes = {"delivered": camera.delivered, "overwritten": camera.overwritten, "bad": camera.bad}
        yield _counter("camera_frames", "Frames by outcome", outcomes, "outcome")
        yield _counter("camera_reopened", "How often a lost camera came back", {"": camera.reopened})
        yield _gauge("link_up", "Whether an autopilot is heard", {}, float(status.link.state == "up"))
        yield _gauge(
            "gps_healthy", "Whether the autopilot uses a good GPS fix", {}, float(status.link.gps == "healthy")
        )
        yield _gauge("gps_wrong", "Whether the places contradict GPS", {}, float(status.link.gps_verdict == "wrong"))
        if status.link.gps_doubt is not None:
            yield _gauge("gps_doubt", "Evidence that GPS is wrong, from 0; called at 1", {}, status.link.gps_doubt)
        if status.link.gps_off_m is not None:
            yield _gauge("gps_off_meters", "How far GPS is from the places", {}, status.link.gps_off_m)
        yield from self._protection(status)
        yield _gauge(
            "journal_lines_lost", "Lines that could not be written since the last one that was", {}, status.journal_lost
        )

    @staticmethod
    def _protection(status: Status) -> Iterable[Metric]:
        link = status.link
        if link.sent_ns is None:
            return
        age_s = (status.stamp_ns - link.sent_ns) / 1e9
        yield _gauge("position_age_seconds", "Time since the newest position was sent", {}, age_s)
        levels = GaugeMetricFamily(
            "lookback_protection_level_meters",
            "Of the newest position that was sent; +Inf where nothing bounds it",
            labels=["direction"],
        )
        for direction, level_m in (("along", link.level_along_m), ("across", link.level_across_m)):
            levels.add_metric([direction], math.inf if level_m is None else level_m)
        yield levels

    @staticmethod
    def _recognizer(status: Status) -> Iterable[Metric]:
        states = GaugeMetricFamily("lookback_state", "1 for the current state", labels=["state"])
        for state in dict.fromkeys((*STATES, status.state)):
            states.add_metric([state], float(state == status.state))
        yield states
        yield _gauge("confidence_from", "Confidence from which on a place is believed", {}, status.confidence_from)
        newest = status.newest
        if newest is not None and newest.place is not None:
            yield _gauge("uniqueness", "Uniqueness of the newest match", {}, newest.uniqueness or 0.0)
            yield _gauge("confidence", "Confidence of the newest match", {}, newest.confidence or 0.0)
            of_map = {"map": newest.map} if newest.map else {}
            yield _gauge("place", "Map row of the newest match", of_map, newest.place)
        stages = GaugeMetricFamily("lookback_stage_seconds", "Median time of a stage of a frame", labels=["stage"])
        for stage, took_ms in status.stages_ms.items():
            stages.add_metric([stage], took_ms / 1e3)
        yield stages


def _gauge(name: str, words: str, labels: dict[str, str], value: float) -> Metric:
    metric = GaugeMetricFamily(f"lookback_{name}", words, labels=list(labels))
    metric.add_metric(list(labels.values()), value)
    return metric


def _counter(name: str, words: str, values: dict[str, int], label: str = "") -> Metric:
    metric = CounterMetricFamily(f"lookback_{name}", words, labels=[label] if label else [])
    for key, value in values.items():
        metric.add_metric([key] if label else [], value)
    return metric
