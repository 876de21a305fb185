"""Parameters are requested one after another: the next one once the last is answered, or overdue."""

from __future__ import annotations

from edge.telemetry.link_protocol import PARAMETER_NS, REQUEST_ANSWER_NS, TRIES_MOST, ParameterRequests
from edge.telemetry.session import Session

NAMES = ("WENC_TYPE", "FLOW_TYPE", "VISO_TYPE")


def requested(requests: ParameterRequests, now_ns: int) -> list[str]:
    return [message.param_id for message in requests.due(1, now_ns)]


def test_an_answer_makes_the_next_one_due_at_once() -> None:
    session = Session()
    requests = ParameterRequests(session, NAMES)
    for name in NAMES:
        assert requested(requests, 0) == [name]
        assert requested(requests, 0) == []
        session.parameters[name] = 0.0
    assert requested(requests, PARAMETER_NS) == []


def test_without_an_answer_the_next_one_waits_and_the_first_comes_again() -> None:
    requests = ParameterRequests(Session(), NAMES)
    assert requested(requests, 0) == [NAMES[0]]
    assert requested(requests, PARAMETER_NS - 1) == []
    assert [requested(requests, turn * PARAMETER_NS) for turn in (1, 2, 3)] == [[NAMES[1]], [NAMES[2]], [NAMES[0]]]


def test_they_are_over_when_each_has_come_or_was_requested_often_enough() -> None:
    session = Session()
    requests = ParameterRequests(session, NAMES[:2])
    session.parameters[NAMES[0]] = 1.0
    for turn in range(TRIES_MOST):
        assert not requests.are_over(turn * PARAMETER_NS)
        assert requested(requests, turn * PARAMETER_NS) == [NAMES[1]]
    last_ns = (TRIES_MOST - 1) * PARAMETER_NS
    assert requested(requests, last_ns + PARAMETER_NS) == []
    assert requests.are_over(last_ns + PARAMETER_NS + REQUEST_ANSWER_NS + 1)
