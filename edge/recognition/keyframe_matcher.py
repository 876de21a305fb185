"""Which frames are verified by keypoints, against which places, and the vote of each for a point along a drive."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from itertools import chain, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edge.config import Config
from edge.geodesy import east_north
from edge.keypoints.network import KeypointNetwork
from edge.keypoints.pose import MOST_AHEAD_M
from edge.recognition.place_verification import PlaceVerification
from edge.reference_map import Drives, MapSet
from edge.sequence import Correspondences, DeadReckoningPosition, KeyframeMatch, MotionPrior, PlaceMatch
from edge.sequence.consensus import PlaceBelief
from edge.sequence.keyframe_consensus import (
    AGREE_M,
    ALONE,
    KEPT_VOTES,
    VOTES_M,
    KeyframeConsensus,
    KeyframeVote,
    PriorOf,
    joined,
    sign_of,
)
from edge.sequence.place_search import NearestOf

EVERY, IN_VAIN_EVERY, PATIENCE = 2, 4, 10
"""One in so many frames is verified where the vehicle is not reckoned, and after so many verifications in vain. With 5
pictures of 320 x 240 a second, front on a front camera's map, the daemon took 32 ms a second without keypoints, and 75
where every second frame was verified against all candidates."""
NEAREST_PLACES, PLACES_APART = 30, 2
"""Places by the newest frame alone that are tried where nothing is believed, and how far they are apart: on the way
home on a rear camera's map (two roads, 240 frames) one within 8 m of the right one was among 10 of them in .93, among
30 in .996. Its pose then says which of its neighbors is nearest."""
AMONG = 200
"""Places by the newest frame alone that these are chosen from: others are neighbors, or were seen another way."""
POSES_APART_M = 1.0
"""Driven between two of them where the vehicle is reckoned to be: nearer pictures err alike, and each costs as much as
three frames without keypoints."""
LIKELY = 0.5
"""Confidence of keyframe matches from which their pose goes with a sequence match: on an unmapped road it was less."""
CENTERED_M, RECKONED_M = 4.0, 10.0
"""Sigma of the place that is reckoned: from where on a pose is sought in WINDOWS_M as well, and where no longer."""
WINDOWS_M = 0.0, -10.0, 10.0
"""Along the drive, from that place to the middles of local maps."""
BESIDE_M, DRIVES = 8.0, 3
"""From the middle of the first of them: of other drives on the road that are tried, and how many at most."""
NEAR_SIGMAS = 2.0
"""Of a position by GPS, by which a lane may be further from it than BESIDE_M."""
ELSEWHERE_EVERY = 4
"""Where verification is in vain though the vehicle is reckoned, one frame in so many is verified by places anywhere,
and the first time the next one as well: it may have been carried."""


Image = NDArray[np.uint8]


class ReckonedPlace(NamedTuple):
    """A place that keyframe matches believed, after so many meters were driven, to that sigma of the odometer."""

    place: PlaceBelief
    at_m: float
    uncertain_m: float

    def at(self, driven_m: float) -> PlaceBelief:
        """The place of the vehicle once it has driven so far."""
        along_m = self.place.along_m + sign_of(self.place.direction) * (driven_m - self.at_m)
        return replace(self.place, along_m=along_m)


class JointBelief(NamedTuple):
    """The belief by votes and keyframe matches together.

    votes: the place that votes speak for, weighed with keyframe matches. match: of a place that keyframe matches
    believe, where votes believe no sequence match to it. seen: keyframe match of the newest frame, where they do.
    """

    votes: PlaceBelief | None
    match: PlaceMatch | None = None
    seen: KeyframeMatch | None = None


class KeyframeMatcher:
    """Matches some frames of a drive with the keyframes of some maps."""

    def __init__(self, map_set: MapSet, drives: Drives, config: Config, network: KeypointNetwork | None = None) -> None:
        """network: None for one that is opened when it is needed."""
        self.verification, self._least = PlaceVerification(config), config.acceptance.confidence_from
        if network is not None:
            self.verification.network = network
        self.grow(map_set, drives)
        self.reset()

    def grow(self, map_set: MapSet, drives: Drives) -> None:
        """Match with a set from now on that has further places after those of the last one."""
        self.verification.use_maps(map_set, drives)
        self._map_set, self._drives = map_set, drives

    def reset(self) -> None:
        """No match so far counts."""
        self._kept = KeyframeConsensus()
        self._alike = deque[list[KeyframeVote]](maxlen=KEPT_VOTES)
        """By each of the newest verifications, two places that it could not tell apart; none by one that could."""
        self._unverified, self._in_vain = IN_VAIN_EVERY, 0  # frames since a verification, verifications since a match
        self._reckoned: ReckonedPlace | None = None
        self._seen_m = -math.inf  # driven at the newest match
        self._is_opposed = False  # to the views at the place that is believed
        self._newest: tuple[KeyframeMatch, KeyframeVote] | None = None  # of the newest frame, if it was verified
        self.was_carried = False
        """Whether keyframe matches believe another place than where the vehicle is reckoned, and none shows that."""

    @property
    def correspondences(self) -> Correspondences | None:
        """The points by which the newest frame shows the place that is believed; None where it was not verified."""
        return self.verification.correspondences if self._newest is not None else None

    def is_due(self, driven_m: float) -> bool:
        """Whether this frame is to be verified; driven_m: by the odometer."""
        self._unverified += 1
        self._newest = None
        every = IN_VAIN_EVERY if self._in_vain >= PATIENCE else EVERY
        is_far = abs(driven_m - self._seen_m) >= POSES_APART_M
        is_due = self._unverified >= every if self._reckoned is None else is_far
        return is_due and self.verification.is_possible and not self._is_opposed

    def verify(
        self, image: Image, nearest: NearestOf, travel: MotionPrior, driven_m: float, uncertain_m: float
    ) -> None:
        """Verify a picture by the local map where the vehicle is reckoned to be, or else by its nearest places.

        driven_m, uncertain_m: odometer, its sigma. MapError as `costs`.
        """
        verification, course_rad = self.verification, travel.course_rad
        middles = self._middles(course_rad, driven_m, uncertain_m)
        near = [] if middles else self._near(travel.dead_reckoning, course_rad)
        places = middles or verification.candidates(nearest(AMONG), course_rad, NEAREST_PLACES, PLACES_APART)
        if not (places or near):
            self._in_vain += 1
            return
        self._unverified = 0
        local = chain(middles, self._beside(middles[0], course_rad)) if middles else ()
        seen = verification.follow(image, local) if middles else verification.verify(image, places, near)
        vote = self._vote_of(seen, driven_m, uncertain_m, is_reckoned=bool(middles)) if seen else None
        self._newest = (seen, vote) if seen and vote else None
        self._kept.add(vote)
        self._alike.append([self._vote_of(one, driven_m, uncertain_m) for one in self.verification.alike])
        self._seen_m = self._seen_m if vote is None else driven_m
        if vote is None:
            self._in_vain += 1
        elif middles or not self._is_elsewhere(vote, driven_m):
            self._in_vain *= vote.odds * ALONE < 1  # a faint one shows little
        else:  # the next frame is verified by places anywhere as well
            belief = self._kept.belief(driven_m, self._least, self._drives.positions_m)
            self.was_carried = belief is not None and belief.is_believed

    def answer(
        self, votes: PlaceBelief | None, prior_of: PriorOf | None, driven_m: float, slack_m: float
    ) -> JointBelief:
        """The belief by votes and keyframe matches together.

        prior_of: odds of being at a point along a drive without either. slack_m: by how much two votes may differ.
        """
        keyframes = self._kept.belief(driven_m, self._least, self._drives.positions_m, prior_of)
        votes = self._doubted(votes, prior_of, driven_m, slack_m)
        if keyframes is None or not self._is_mapped(keyframes):
            return JointBelief(votes)
        is_one_place = votes is not None and self._is_one_place(votes, keyframes, slack_m)
        seen = self._seen_at(keyframes) if keyframes.confidence >= LIKELY else None
        by_keyframes, by_votes = joined(keyframes, votes, self._least, is_one_place=is_one_place)
        if is_one_place and votes is not None and votes.is_believed:
            return JointBelief(by_votes, seen=seen)
        return JointBelief(by_votes, self._match_of(by_keyframes, seen) if by_keyframes.is_believed else None)

    def follow(self, match: PlaceMatch | None, driven_m: float, uncertain_m: float, slack_m: float) -> None:
        """Reckon from the next frame on by the place that is believed, where keyframe matches show it; None: as before.

        driven_m, uncertain_m: odometer, its sigma.
        """
        self._is_opposed = match is not None and self._is_seen_from_behind(match)
        keyframes = self._kept.belief(driven_m, self._least, self._drives.positions_m)
        if match is None or keyframes is None or keyframes.confidence < LIKELY:
            return
        drive, along_m = self._drives.drive_of(match.place_index), self._drives.along_m(match.place_index)
        place = PlaceBelief(drive, along_m, match.direction, match.confidence, is_believed=True)
        if self._is_one_place(place, keyframes, slack_m):
            self._reckoned = ReckonedPlace(keyframes, driven_m, uncertain_m)

    def _doubted(
        self, votes: PlaceBelief | None, prior_of: PriorOf | None, driven_m: float, slack_m: float
    ) -> PlaceBelief | None:
        """The votes' belief, beside places elsewhere that verification could not tell from another one."""
        against = 0.0
        for one in chain.from_iterable(self._alike):
            at_m = one.now_m(driven_m)
            place = PlaceBelief(one.drive, at_m, one.direction, 0.0, is_believed=False)
            if votes is not None and driven_m - one.at_m <= VOTES_M and not self._is_one_place(votes, place, slack_m):
                several = ALONE if sum(map(bool, self._alike)) > 1 else 1.0
                against = max(against, one.odds * several * (prior_of(one.drive, at_m) if prior_of else 1.0))
        if votes is None or not against:
            return votes
        odds = votes.confidence / max(1 - votes.confidence, 1e-9)
        confidence = odds / (1 + odds + against)
        return replace(votes, confidence=confidence, is_believed=confidence >= self._least)

    def _is_elsewhere(self, vote: KeyframeVote, driven_m: float) -> bool:
        """Whether a vote is for another place than that of the map where the vehicle is reckoned to be."""
        if self._reckoned is None:
            return False
        there = self._reckoned.at(driven_m)
        one = PlaceBelief(vote.drive, vote.along_m, vote.direction, 0.0, is_believed=False)
        return self._is_mapped(there) and not self._is_one_place(one, there, RECKONED_M)

    def _is_mapped(self, belief: PlaceBelief) -> bool:
        """Whether a place lies so near that the vehicle may have seen it, not past the end of its drive or in a gap."""
        nearest_m = self._drives.along_m(self._drives.nearest(belief.drive, belief.along_m))
        return abs(math.remainder(belief.along_m - nearest_m, self._drives.lap_m(belief.drive))) <= MOST_AHEAD_M

    def _seen_at(self, belief: PlaceBelief) -> KeyframeMatch | None:
        """The keyframe match of the newest frame, if it is of the place that is believed."""
        if self._newest is None:
            return None
        seen, vote = self._newest
        is_there = vote.drive == belief.drive and abs(vote.along_m - belief.along_m) <= AGREE_M
        return seen if is_there and vote.direction == belief.direction else None

    def _match_of(self, belief: PlaceBelief, seen: KeyframeMatch | None) -> PlaceMatch:
        """The match at a place that keyframe matches alone believe."""
        place_index = self._drives.nearest(belief.drive, belief.along_m) if seen is None else seen.place_index
        name, row = self._map_set.locate(place_index)
        match = PlaceMatch(place_index, row, belief.direction, "same", slope=0.0, distance=0.0, uniqueness=1.0)
        return replace(match, map=name, confidence=belief.confidence, accepted=True, seen=seen, has_line=False)

    def _is_one_place(self, one: PlaceBelief, other: PlaceBelief, slack_m: float) -> bool:
        """Whether two beliefs differ by no more than two votes may."""
        if (one.drive, one.direction) == (other.drive, other.direction):
            return abs(math.remainder(one.along_m - other.along_m, self._drives.lap_m(one.drive))) <= slack_m
        drives, along_m = np.array([one.drive, other.drive]), np.array([one.along_m, other.along_m])
        return bool(np.hypot(*np.diff(self._drives.positions_m(drives, along_m), axis=0)[0]) <= slack_m)

    def _middles(self, course_rad: float | None, driven_m: float, uncertain_m: float) -> list[int]:
        """The middles of the local maps to look at; none where the vehicle is not reckoned, or may be elsewhere."""
        if self._reckoned is None or self._in_vain == ELSEWHERE_EVERY or (self._in_vain + 1) % ELSEWHERE_EVERY == 0:
            return []
        sigma_m = abs(uncertain_m - self._reckoned.uncertain_m)
        if sigma_m > RECKONED_M:
            self._reckoned = None
            return []
        windows_m, middle = (WINDOWS_M if sigma_m > CENTERED_M else WINDOWS_M[:1]), self._reckoned.at(driven_m)
        there = (replace(middle, along_m=middle.along_m + window_m) for window_m in windows_m)
        places = [self._drives.nearest(one.drive, one.along_m) for one in there if self._is_mapped(one)]
        return self.verification.candidates(np.array(places, np.intp), course_rad, len(WINDOWS_M), 1)

    def _near(self, reckoned: DeadReckoningPosition | None, course_rad: float | None) -> list[int]:
        """The middles of local maps around the position by GPS, of each drive there; none where it is not known."""
        if reckoned is None or reckoned.sigma_m > RECKONED_M:
            return []
        windows_m = WINDOWS_M if reckoned.sigma_m > CENTERED_M else WINDOWS_M[:1]
        reach_m = BESIDE_M + NEAR_SIGMAS * reckoned.sigma_m
        nearest = self._nearest_of_drives((reckoned.lat_deg, reckoned.lon_deg), reach_m)
        there = product(self.verification.candidates(nearest, course_rad, DRIVES, 1), windows_m)
        return [self._drives.nearest(self._drives.drive_of(one), self._drives.along_m(one) + m) for one, m in there]

    def _beside(self, place: int, course_rad: float | None) -> list[int]:
        """The nearest place of each other drive within BESIDE_M of one, the nearest first, DRIVES at most."""
        here = self._map_set.places[place]
        nearest = self._nearest_of_drives((float(here["lat_deg"]), float(here["lon_deg"])), BESIDE_M)
        return self.verification.candidates(nearest[nearest != place], course_rad, DRIVES, 1)

    def _nearest_of_drives(self, at_deg: tuple[float, float], reach_m: float) -> NDArray[np.intp]:
        """The nearest places within so many meters of a latitude and longitude, one each time that a drive passed."""
        found = []
        for _, start, end in self._map_set.index.by_segment(self._map_set.blocks.within(*at_deg, reach_m)):
            rows = self._map_set.places[start:end]
            away_m = np.nan_to_num(np.hypot(*east_north(rows["lat_deg"], rows["lon_deg"], at_deg).T), nan=np.inf)
            found.append((float(away_m.min()), start + int(away_m.argmin())))
        return np.array([place for away_m, place in sorted(found) if away_m <= reach_m], np.intp)

    def _is_seen_from_behind(self, match: PlaceMatch) -> bool:
        """Whether the views at a place are opposite, and those of all other drives there."""
        if self.verification.direction(match.place_index) == match.direction:
            return False
        heading_rad = math.radians(float(self._map_set.places["heading_deg"][match.place_index]))
        return not self._beside(match.place_index, heading_rad + math.pi * (match.direction == "reverse"))

    def _vote_of(
        self, seen: KeyframeMatch, driven_m: float, uncertain_m: float, *, is_reckoned: bool = False
    ) -> KeyframeVote:
        """A keyframe match as a vote for a point along the map's drive; the place's camera faces along it, or back."""
        drive, direction = self._drives.drive_of(seen.place_index), self.verification.direction(seen.place_index)
        along_m = self._drives.along_m(seen.place_index) + self.verification.facing(seen.place_index) * seen.ahead_m
        odds = seen.confidence / (1 - seen.confidence)
        said = odds, seen.right_m * self.verification.facing(seen.place_index), seen.turn_rad, is_reckoned
        return KeyframeVote(drive, along_m, direction, self._drives.lap_m(drive), driven_m, uncertain_m, *said)
