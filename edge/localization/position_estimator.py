"""Where the vehicle is, and whether that may be published: all that follows from matches and from what is reported.

    a used frame:  `update`, with its match, the motion and GPS: the route filter, GPS by the places, the evidence
    every turn:    `bind_by_gps`, and `bind` where the autopilot has used a position
    a position:    `position_at_exposure` or `position`, and `decide`: whether it may be published

Pure: no link, no clock, no file; what is reported comes in as a `Report`. The daemon, and with it the trial and the
replays of recorded drives, and the hours of the protection level call this object alike.
"""

from __future__ import annotations

from edge.config import Config
from edge.journal.records import FrameUsed, PlaceFix
from edge.localization.bound import BOUND_WRONG, OwnPosition
from edge.localization.dead_reckoning import Displacement
from edge.localization.gps_judge import GpsJudge
from edge.localization.gps_referee import GpsFix, GpsVerdict
from edge.localization.integrity import Decision, Integrity, Limits, Situation
from edge.localization.place_fix import LineMiddle, frame_used, line_middle, untracked_fix
from edge.localization.report import Report
from edge.localization.route_filter import RouteFilter
from edge.reference_map import MapSet, Route
from edge.sequence import PlaceMatch

CALLED_SIGMA_M = 10.0
"""Of the autopilot's position less the error of GPS, when GPS is called wrong."""


class PositionEstimator:
    """Follows one vehicle, one frame and one report after another."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._route: Route | None = None
        self._filter: RouteFilter | None = None
        self._gps = GpsJudge(config)
        self._integrity = Integrity(config.gates)
        self._own = OwnPosition(config.gates.drift_percent / 100)
        self._velocity_error = 0.0  # of the autopilot, as a share, by the newest position

    def use_maps(self, maps: MapSet) -> None:
        """Follow the vehicle along the drives of these maps; what is known of GPS and of the autopilot stays."""
        self._route = Route(maps)
        self._filter = RouteFilter(self._route, self._config)
        self._gps.use_route(self._route)

    def grow(self, maps: MapSet) -> None:
        """Follow the vehicle along maps that have further places after those of the last ones."""
        assert self._route is not None
        self._route.grow(maps)

    def reset(self) -> None:
        """Begin anew: no position is published that rests on frames from before. What is known of GPS stays."""
        if self._filter is not None:
            self._filter.reset()
        self._gps.reset()

    def restart(self) -> None:
        """The autopilot may be another one, or has rebooted: nothing bounds its position any more.

        What places and GPS showed of the vehicle holds as far as it can have gone meanwhile (`Displacement.unknown_m`).
        """
        self._own.restart()

    def update(
        self,
        match: PlaceMatch | None,
        stamp_ns: int,
        displacement: Displacement | None,
        report: Report,
        gps: GpsFix | None = None,
        *,
        missed: int = 0,
        in_line: bool = True,
        stamp_sigma_s: float = 0.0,
    ) -> GpsVerdict:
        """Use the answer to one frame; what the places say of GPS since: "wrong" until it agrees again.

        displacement, gps: at its exposure. missed: see `RouteFilter.update`. in_line: whether a line may
        lead through the frame, see `PlaceRecognizer`. stamp_sigma_s: one standard deviation of the time of exposure.
        """
        assert self._filter is not None
        believed, undated_m = self._gps.believed(report), stamp_sigma_s * (report.speed_mps or 0.0)
        self._filter.update(match, stamp_ns, displacement, missed, in_line=in_line, undated_m=undated_m)
        if in_line and self._gps.update(match, gps, displacement, believed, self._own.by_gps, missed, undated_m):
            self._filter.reject_gps()
        # GPS bounds the autopilot's position, and so that of the vehicle, while nothing speaks against GPS.
        own, sigma_m = believed.position, believed.gps_sigma_m
        if own is not None and sigma_m is not None and not self._gps.is_doubted:
            self._filter.bind(own, sigma_m)
        fix = self._filter.at_exposure()
        if fix is not None and fix.stamp_ns == stamp_ns:
            self.observe(fix, report, displacement)
        return self.use_verdict(self._gps.verdict, report) if in_line else self._gps.verdict

    def observe(self, fix: PlaceFix, report: Report, displacement: Displacement | None) -> None:
        """Keep what a position shows of the places, whether or not it may be published."""
        self._velocity_error = fix.velocity_error
        self._integrity.observe(fix, self._situation(fix, displacement, self._gps.believed(report), None))

    def use_verdict(self, verdict: GpsVerdict, report: Report) -> GpsVerdict:
        """What the places say of GPS from now on; the verdict, which stays "wrong" until GPS agrees again."""
        ignored = self.ignores_gps
        verdict = self._gps.use(verdict, report)
        if self.ignores_gps and not ignored:
            # What GPS has contradicted so far is not contradicted any more.
            self._bind(CALLED_SIGMA_M, report)
            self._own.by_gps = None
        return verdict

    @property
    def gps_is_wrong(self) -> bool:
        """Whether GPS was called wrong, and has not agreed since."""
        return self._gps.is_wrong

    @property
    def gps_agrees(self) -> bool:
        """Whether the newest places agree with GPS; False where they cannot say."""
        return self._gps.agrees

    @property
    def ignores_gps(self) -> bool:
        """Whether positions are published as if GPS were lost."""
        return self._gps.is_ignored

    def bind_by_gps(self, report: Report) -> None:
        """GPS bounds the autopilot's position now, as `report.gps_sigma_m` says, if it does."""
        report = self._gps.believed(report)
        self._own.watch_aid(report)
        if report.gps_sigma_m is not None:
            self._bind(report.gps_sigma_m, report, by_gps=True)
            self._own.anchor(report)

    def bind(self, sigma_m: float, report: Report, wrong: float = BOUND_WRONG) -> None:
        """The autopilot has used a position: its own is as good as that now. Of one that nothing aids, nobody knows.

        wrong: the probability that the position was.
        """
        if report.is_aided:
            self._bind(sigma_m, report, wrong)
            self._gps.bound()

    def _bind(self, sigma_m: float, report: Report, wrong: float = BOUND_WRONG, *, by_gps: bool = False) -> None:
        self._own.bind(sigma_m, report, wrong, by_gps=by_gps)
        self._integrity.contradict_nothing()

    @property
    def is_bounded(self) -> bool:
        """Whether GPS or a position of ours has bounded the autopilot's since its boot."""
        return self._own.bound is not None

    def uncertainty_m(self, report: Report) -> float | None:
        """One standard deviation of the autopilot's own position, None where nothing has ever bound it."""
        return self._own.sigma_m(report, self._velocity_error, report.accuracy_m or 0.0)

    def bounded_m(self, report: Report) -> float | None:
        """The same by what bounded it and the distance driven since alone."""
        return self._own.sigma_m(report)

    def position_at_exposure(self) -> PlaceFix | None:
        """The position at the exposure of the last match that agreed; None while the vehicle is lost."""
        return None if self._filter is None else self._filter.at_exposure()

    def position(self, stamp_ns: int, displacement: Displacement | None) -> PlaceFix | None:
        """The position at another moment, by the autopilot's velocity since; None while that is not known."""
        return None if self._filter is None else self._filter.at(stamp_ns, displacement)

    def decide(
        self,
        fix: PlaceFix,
        limits: Limits,
        last_sent_ns: int | None,
        report: Report,
        displacement: Displacement | None,
    ) -> Decision:
        """Whether a position may be published now; asking changes nothing.

        last_sent_ns: when the last one was. displacement: by the autopilot's velocity at the position's moment.
        """
        situation = self._situation(fix, displacement, self._gps.believed(report), last_sent_ns)
        return self._integrity.decide(fix, situation, limits)

    def _situation(
        self, fix: PlaceFix, displacement: Displacement | None, report: Report, last_sent_ns: int | None
    ) -> Situation:
        reckoned = self._own.reckoned(fix, displacement, report)
        own, sigma_m, bound = report.position, self.uncertainty_m(report), self._own.bound
        is_by_gps, wrong = (False, BOUND_WRONG) if bound is None else (bound.by_gps, bound.wrong)
        if not report.is_aided:  # its own position has run away, or is ours
            own = None
        if sigma_m is None and reckoned is not None:  # as after a reboot too
            own, sigma_m, is_by_gps, wrong = reckoned.position(fix), reckoned.sigma_m, True, BOUND_WRONG
        return Situation(
            report.now_ns,
            report.gps,
            report.speed_mps,
            own,
            sigma_m,
            is_by_gps,
            last_sent_ns,
            displacement,
            reckoned,
            report.is_aided,
            wrong,
        )

    def line_of(self, match: PlaceMatch) -> LineMiddle | None:
        """Where the line of a believed match lies along the map's drive; None where it says nothing of that."""
        assert self._route is not None
        is_sure = match.accepted and match.uniqueness >= 1
        return line_middle(match, self._route, self._config.sequence_frames) if is_sure else None

    def place_fix(self, match: PlaceMatch, stamp_ns: int) -> PlaceFix:
        """An event: with the position of the vehicle if it is followed, else with the place's own."""
        assert self._filter is not None and self._route is not None
        fix = self._filter.at_exposure()
        if fix is None or fix.stamp_ns != stamp_ns:
            fix = untracked_fix(match, stamp_ns, self._route, self._config.rig)
        return fix

    def frame_used(self, frame: int, stamp_ns: int, match: PlaceMatch | None, missed: int = 0) -> FrameUsed:
        """The record of a frame and of its match. missed: places passed without a frame before it."""
        assert self._route is not None
        return frame_used(frame, stamp_ns, match, self._route, self._config.rig, missed)
