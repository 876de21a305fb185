"""G: the main task, and the whole of what Lookback is for: the autopilot steers itself home by its own estimate."""

from __future__ import annotations

from sim.research.trial.course_rules import close, sends
from sim.research.trial.courses.registry import course
from sim.trial.draft import Draft
from sim.trial.rules import no_false_place, not_worse, resumes, within_sigmas
from sim.trial.take_me_home import home_in

HOME_LIGHTS = ("day", "dusk", "night", "rain")


@course("G", "home")
def _home(draft: Draft) -> None:
    """The main task: the autopilot drives home at night without GPS, over a road that is mapped whole."""
    draft.rules = (within_sigmas, no_false_place, not_worse, close, sends, resumes)


@course("G", "take-me-home")
def _take_me_home(draft: Draft) -> None:
    """Out by day, mapped by a rear camera; GPS is lost at the turn; home on that map, in one of four lights."""
    home_in(draft, str(draft.rng.choice(HOME_LIGHTS)))


course("G", "take-me-home-{}", *HOME_LIGHTS)(home_in)


@course("G", "person")
def _person(draft: Draft) -> None:
    """A person keeps to the lane, whatever the autopilot believes."""
    draft.steers = False
    draft.rules = (within_sigmas, no_false_place, not_worse, sends, resumes)
