"""E: lost messages, silence, and restarts of the daemon and of the autopilot."""

from __future__ import annotations

from sim.trial.courses.registry import course
from sim.trial.draft import GPS_S, Draft, is_command
from sim.trial.rules import (
    no_false_place,
    not_with_gps,
    not_worse,
    resumes,
    sends,
    sources_restored,
    within_sigmas,
)
from sim.vehicle.gps import NO_FIX, GpsReport


@course("E", "lost-acknowledgements")
def _lost_acknowledgements(draft: Draft) -> None:
    """Every second answer of the autopilot is lost."""
    draft.loses = lambda time_s, message, outgoing: (
        outgoing and message.get_type() == "COMMAND_ACK" and int(time_s) % 2 == 0
    )
    draft.rules = (within_sigmas, no_false_place, not_worse, sends)


@course("E", "lost-source-set")
def _lost_source_set(draft: Draft) -> None:
    """The command that selects the second set of sources is lost until 31 s after GPS; GPS comes back later."""
    draft.emit = "vision_position"
    draft.loses = lambda time_s, message, outgoing: not outgoing and time_s < 40.0 and is_command(message, 42007)
    draft.rules = (within_sigmas, no_false_place, sources_restored)
    draft.gps_at = lambda time_s: NO_FIX if GPS_S <= time_s < draft.share(0.8) / 8.0 else GpsReport()


@course("E", "silence-{}", 6, 60)
def _silence(draft: Draft, value: float) -> None:
    """Nothing but heartbeats from the autopilot for some seconds."""
    draft.silence_s = (draft.share(0.4) / 8.0, draft.share(0.4) / 8.0 + value)
    draft.unsent = [(draft.share(0.3), draft.share(0.4) + value * 10.4 + 80)]
    draft.rules = (within_sigmas, no_false_place, not_worse, resumes)


@course("E", "daemon-killed")
def _daemon_killed(draft: Draft) -> None:
    """The daemon dies in the middle of the drive, without a word, and is started again."""
    draft.killed_s = draft.share(0.5) / 8.0
    draft.rules = (within_sigmas, no_false_place, not_worse, resumes)
    draft.unsent = [(draft.share(0.35), draft.share(0.65) + 40)]


@course("E", "autopilot-restarted")
def _autopilot_restarted(draft: Draft) -> None:
    """The autopilot restarts while the vehicle is driven on."""
    draft.restarted_s = draft.share(0.5) / 8.0
    draft.steers = False


@course("E", "gps-returns")
def _gps_returns(draft: Draft) -> None:
    """GPS comes back while positions go unanswered: none may be sent again then."""
    back_s = draft.share(0.6) / 8.0
    draft.gps_at = lambda time_s: GpsReport() if not GPS_S <= time_s < back_s else NO_FIX
    draft.loses = lambda time_s, message, outgoing: outgoing and message.get_type() == "COMMAND_ACK"
    draft.rules = (within_sigmas, no_false_place, not_with_gps)
