"""E: lost messages, silence, and restarts of the daemon and of the autopilot. F: an odometer, a heading, a map and a
clock that are not as usual."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim.research.trial import course_rules as rule
from sim.research.trial.course import CONFIRMED_M, DOWN_S, GPS_S, CourseDraft, course, is_command
from sim.vehicle.gps import NO_FIX, GpsReport


@course("E", "lost-acknowledgements", rules=(*rule.USUAL, rule.sends))
def _lost_acknowledgements(draft: CourseDraft) -> None:
    """Every second answer of the autopilot is lost."""
    draft.loses = lambda time_s, message, outgoing: (
        outgoing and message.get_type() == "COMMAND_ACK" and int(time_s) % 2 == 0
    )


@course("E", "lost-source-set", least_m=1000.0, rules=(*rule.HONEST, rule.sources_restored))
def _lost_source_set(draft: CourseDraft) -> None:
    """GPS is 60 m wrong for a while; the command that selects the second set of sources is lost for the first 15 s."""
    wrong_s, right_s = draft.share(0.4) / 8.0, draft.share(0.7) / 8.0
    wrong = GpsReport(east_off_m=draft.side(60.0)[0], north_off_m=draft.side(60.0)[1])
    draft.gps_at = lambda time_s: wrong if wrong_s <= time_s < right_s else GpsReport()
    draft.loses = lambda time_s, message, outgoing: (
        not outgoing and time_s < wrong_s + 15.0 and is_command(message, 42007)
    )
    draft.steers, draft.doubted_gps = False, "switch"


@course("E", "silence-{}", 6, 60, rules=(*rule.USUAL, rule.resumes))
def _silence(draft: CourseDraft, value: float) -> None:
    """Nothing but heartbeats from the autopilot for some seconds."""
    draft.silence_s = (draft.share(0.4) / 8.0, draft.share(0.4) / 8.0 + value)
    draft.unsent = [(draft.share(0.3), draft.share(0.4) + value * 10.4 + 80)]


@course("E", "daemon-killed", rules=(*rule.USUAL, rule.resumes))
def _daemon_killed(draft: CourseDraft) -> None:
    """The daemon dies in the middle of the drive, without a word, and is back 6 to 10 s later."""
    draft.killed_s, draft.down_s = draft.share(0.5) / 8.0, draft.rng.uniform(*DOWN_S)
    draft.unsent = [(draft.share(0.35), draft.share(0.65) + 140)]


@course("E", "autopilot-restarted-{}", 120, 300, least_m=1200.0, rules=(*rule.USUAL, rule.sends))
def _autopilot_restarted(draft: CourseDraft, value: float) -> None:
    """The autopilot restarts without GPS, so many meters from its origin: it believes to be there. A person drives."""
    draft.restarted_s, draft.origin_off_m = value / 8.0, (0.0, 0.0)
    draft.steers = False
    draft.unsent = [(value - 20.0, value + CONFIRMED_M)]


@course("E", "another-companion", rules=rule.HONEST)
def _another_companion(draft: CourseDraft) -> None:
    """Another computer on the vehicle resets the autopilot every 10 s, by positions that are 3 m wrong."""
    draft.companion_s = 10.0


@course("E", "frozen-30")
def _frozen(draft: CourseDraft) -> None:
    """The camera delivers the same picture for 30 s."""
    draft.frozen_s = draft.share(0.3) / 8.0, draft.share(0.3) / 8.0 + 30.0


@course("E", "clock-3")
def _clock(draft: CourseDraft) -> None:
    """The autopilot's answers to TIMESYNC are 3 s ahead of the clock of its messages."""
    draft.clock_off_s = 3.0


@course("E", "pictures-{}", 0.5, 1, 1.5, 3)
def _pictures(draft: CourseDraft, value: float) -> None:
    """Pictures are so many seconds older than they say, as behind the buffer of a network stream."""
    draft.late_s = value


@course("E", "gps-returns", rules=(*rule.HONEST, rule.not_with_gps))
def _gps_returns(draft: CourseDraft) -> None:
    """GPS comes back while positions go unanswered: none may be sent again then."""
    back_s = draft.share(0.6) / 8.0
    draft.gps_at = lambda time_s: GpsReport() if not GPS_S <= time_s < back_s else NO_FIX
    draft.loses = lambda time_s, message, outgoing: outgoing and message.get_type() == "COMMAND_ACK"


@course("F", "odometer{:+d}", -15, -3, 3, 12)
def _odometer(draft: CourseDraft, value: int) -> None:
    """The wheels measure so many percent too much."""
    draft.errors = replace(draft.errors, scale=1.0 + value / 100.0)


@course("F", "wheels-slip{:+d}", -12, 10)
def _wheels_slip(draft: CourseDraft, value: int) -> None:
    """The wheels measure so many percent more from the middle of the way on, as on another surface."""
    draft.errors = replace(draft.errors, slips=1.0 + value / 100.0, slips_from_m=draft.share(0.45))


@course("F", "wheels-spin")
def _wheels_spin(draft: CourseDraft) -> None:
    """The wheels turn 1.5 times too fast for 3 s of every 20 s."""
    draft.errors = replace(draft.errors, spins=1.5)


@course("F", "heading-3")
def _heading(draft: CourseDraft) -> None:
    """Dead reckoning goes 3 degrees to the side all the time."""
    draft.errors = replace(draft.errors, heading_deg=3.0 * np.sign(draft.errors.heading_deg))


@course("F", "irregular-map", rules=(*rule.USUAL, rule.sends))
def _irregular(draft: CourseDraft) -> None:
    """Places every 1 to 5 m."""
    draft.map = [replace(draft.map[0], spacing_m=(1.0, 5.0))]


@course("F", "no-headings", rules=(*rule.USUAL, rule.sends))
def _no_headings(draft: CourseDraft) -> None:
    """A map whose places have no heading."""
    draft.map = [replace(draft.map[0], headings=False)]


@course("F", "clock-wrap", rules=(*rule.USUAL, rule.resumes))
def _clock_wrap(draft: CourseDraft) -> None:
    """The autopilot's clock in milliseconds wraps in the middle of the drive, 49.7 days after boot."""
    draft.booted_before_s = 2**32 / 1e3 - draft.share(0.6) / 8.0
