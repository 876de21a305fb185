from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from edge.camera import Camera, Frame
from edge.camera.newest import NewestFrame
from edge.camera.recorded import RecordedCamera
from edge.errors import CameraLost, ConfigError, FrameError
from edge.feed import read_feed
from tests.common import PATIENCE_S

NEXT_STAMP_NS = count(1_000)


class ScriptedCamera:
    """Gives what it is told to: a frame for an int, an error for an error; then ends, or waits to be let go.

    drained: set once the script is used up, when all of its frames have been put. closed: set by close().
    """

    differences: tuple[str, ...] = ("fps: asked for 30, device gives 25",)
    read_timeout_s = 10.0

    def __init__(
        self,
        *script: int | Exception,
        stamps_ns: tuple[int, ...] = (),
        then_wait: threading.Event | None = None,
    ) -> None:
        self._script = iter(script)
        self._stamps_ns = list(stamps_ns) or [next(NEXT_STAMP_NS) for _ in script]
        self._then_wait = then_wait
        self.threads: set[str] = set()
        self.drained = threading.Event()
        self.closed = threading.Event()

    def read(self) -> Frame | None:
        self.threads.add(threading.current_thread().name)
        step = next(self._script, None)
        if isinstance(step, Exception):
            raise step
        if step is None:
            self.drained.set()
            if self._then_wait is not None:
                self._then_wait.wait(PATIENCE_S)
            return None
        return Frame(np.zeros((2, 2, 3), np.uint8), self._stamps_ns.pop(0), step)

    def close(self) -> None:
        self.threads.add(threading.current_thread().name)
        self.closed.set()


def opener(*results: Camera | Exception) -> Callable[[], Camera]:
    remaining = iter(results)

    def open_next() -> Camera:
        result = next(remaining)
        if isinstance(result, Exception):
            raise result
        return result

    return open_next


def taken(newest: NewestFrame) -> Frame:
    """The newest frame, which must come."""
    frame = newest.take(PATIENCE_S)
    assert frame is not None
    return frame


@pytest.fixture
def let_go() -> threading.Event:
    return threading.Event()


def test_only_the_newest_frame_is_kept_and_what_it_replaced_is_counted(let_go: threading.Event) -> None:
    camera = ScriptedCamera(0, 1, 2, then_wait=let_go)
    newest = NewestFrame(opener(camera))
    assert camera.drained.wait(PATIENCE_S)
    health = newest.health
    assert (health.state, health.delivered, health.overwritten, health.bad) == ("running", 3, 2, 0)
    assert health.differences == camera.differences
    assert taken(newest).index == 2
    assert newest.take(0.0) is None
    assert not newest.ended
    let_go.set()
    newest.close()


def test_the_end_of_a_feed_is_visible_after_its_last_frame() -> None:
    camera = ScriptedCamera(0, 1)
    newest = NewestFrame(opener(camera))
    assert camera.closed.wait(PATIENCE_S)
    assert newest.health.state == "ended"
    assert not newest.ended
    assert taken(newest).index == 1
    assert newest.ended
    assert newest.take(PATIENCE_S) is None
    newest.close()


def test_each_frame_of_a_real_time_feed_is_taken_once_or_counted_as_overwritten(feed_path: Path) -> None:
    newest = NewestFrame(lambda: RecordedCamera(read_feed(feed_path)))
    taken = []
    while not newest.ended:
        frame = newest.take(PATIENCE_S)
        if frame is not None:
            taken.append(frame.index)
    newest.close()
    assert taken == sorted(set(taken))
    assert len(taken) + newest.health.overwritten == newest.health.delivered == 12


@pytest.mark.parametrize(
    ("steps", "stamps_ns", "newest_ns"),
    [((0, FrameError("frame 1 is torn"), 2), (), None), ((0, 1, 2, 3), (10, 20, 20, 15), 20)],
    ids=["torn", "its stamp goes back"],
)
def test_a_bad_frame_is_counted_and_the_camera_goes_on(
    steps: tuple[int | Exception, ...], stamps_ns: tuple[int, ...], newest_ns: int | None
) -> None:
    camera = ScriptedCamera(*steps, stamps_ns=stamps_ns)
    newest = NewestFrame(opener(camera))
    assert camera.closed.wait(PATIENCE_S)
    assert (newest.health.delivered, newest.health.bad) == (2, len(steps) - 2)
    assert newest_ns in (None, taken(newest).stamp_ns)
    newest.close()


def test_a_lost_camera_is_closed_and_opened_again_and_its_indices_never_go_back(let_go: threading.Event) -> None:
    before = ScriptedCamera(0, 1, CameraLost("/dev/video0: unplugged"))
    after = ScriptedCamera(0, 1, then_wait=let_go)
    newest = NewestFrame(opener(before, CameraLost("not there yet"), after), first_back_off_s=0.001)
    assert after.drained.wait(PATIENCE_S)
    assert before.closed.is_set()
    health = newest.health
    assert (health.state, health.reason, health.reopened) == ("running", "", 1)
    assert taken(newest).index == 3
    let_go.set()
    newest.close()


def test_while_the_camera_is_lost_health_says_why_and_since_when_and_close_does_not_wait_for_the_back_off() -> None:
    camera = ScriptedCamera(0, CameraLost("/dev/video0: unplugged"))
    newest = NewestFrame(opener(camera), first_back_off_s=1e6, longest_back_off_s=1e6, clock_ns=lambda: 5_000)
    assert camera.closed.wait(PATIENCE_S)
    health = newest.health
    assert (health.state, health.reason, health.since_ns) == ("lost", "/dev/video0: unplugged", 5_000)
    assert newest.take(0.0) is not None
    assert newest.take(0.0) is None
    newest.close()
    assert "camera" not in {thread.name for thread in threading.enumerate()}


@pytest.mark.parametrize(("gives", "longest_s"), [((0,), 1e6), ((), 2e-4)], ids=["starts over", "has an end"])
def test_the_back_off(gives: tuple[int, ...], longest_s: float, let_go: threading.Event) -> None:
    """After 24 losses: doubling all along would wait for 1e-4 * 2**24 s in all."""
    lost = CameraLost("gone")
    gone = [ScriptedCamera(*gives, lost) if gives else lost for _ in range(24)]
    last = ScriptedCamera(0, then_wait=let_go)
    newest = NewestFrame(opener(*gone, last), first_back_off_s=1e-4, longest_back_off_s=longest_s)
    assert last.drained.wait(PATIENCE_S)
    let_go.set()
    newest.close()


def test_a_setup_error_of_the_first_opening_is_raised_to_the_caller() -> None:
    with pytest.raises(ConfigError, match="kind"):
        NewestFrame(opener(ConfigError("[camera] kind: no camera is called 'x'")))


def test_the_start_goes_on_while_a_camera_takes_long_to_open() -> None:
    allowed = threading.Event()

    def open_slowly() -> Camera:
        assert allowed.wait(PATIENCE_S)
        raise ConfigError("[camera] device: no such address")

    newest = NewestFrame(open_slowly, start_s=0.0)
    assert (newest.health.state, newest.health.reason) == ("opening", ""), "it is not lost"
    assert newest.take(0.0) is None
    allowed.set()
    with pytest.raises(ConfigError, match="no such address"):
        newest.take(PATIENCE_S)
    newest.close()


def test_a_setup_error_later_on_is_a_camera_that_is_lost() -> None:
    gone = ScriptedCamera(CameraLost("gone"))
    newest = NewestFrame(opener(gone, ConfigError("not a camera"), ScriptedCamera(0)), first_back_off_s=0.001)
    assert newest.take(PATIENCE_S) is not None
    newest.close()


def test_a_defect_in_a_camera_is_raised_where_it_can_be_reported() -> None:
    camera = ScriptedCamera(0, ZeroDivisionError("defect"))
    newest = NewestFrame(opener(camera))
    assert camera.closed.wait(PATIENCE_S)
    assert newest.take(PATIENCE_S) is not None
    with pytest.raises(ZeroDivisionError):
        newest.take(PATIENCE_S)
    newest.close()


def test_one_thread_opens_reads_and_closes_the_camera() -> None:
    camera = ScriptedCamera(0, 1)
    opened_in = []
    blocked: set[int] = set()

    def open_here() -> Camera:
        opened_in.append(threading.current_thread().name)
        blocked.update(signal.pthread_sigmask(signal.SIG_BLOCK, []))
        return camera

    newest = NewestFrame(open_here)
    newest.close()
    newest.close()
    assert camera.closed.is_set()
    assert {*opened_in, *camera.threads} == {"camera"}
    assert {signal.SIGTERM, signal.SIGINT, signal.SIGHUP} <= blocked  # they are for the main thread
    assert signal.SIGTERM not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


def test_a_frame_of_another_size_or_from_the_future_is_a_bad_frame() -> None:
    class Changing(ScriptedCamera):
        def read(self) -> Frame | None:
            frame = super().read()
            if frame is None or frame.index != 1:
                return frame
            return Frame(np.zeros((4, 2, 3), np.uint8), frame.stamp_ns, frame.index)

    camera = Changing(0, 1, 2, 3, stamps_ns=(10, 20, 200_000_000, 30))
    newest = NewestFrame(opener(camera), clock_ns=lambda: 100)
    assert camera.closed.wait(PATIENCE_S)
    assert (newest.health.delivered, newest.health.bad) == (2, 2)
    assert taken(newest).index == 3
    newest.close()


def test_a_camera_that_gives_only_bad_frames_is_opened_again_and_its_clock_may_begin_anew(
    let_go: threading.Event,
) -> None:
    clock = count(0, 400_000_000)  # each look at the clock takes 0.4 s
    stuck = ScriptedCamera(0, 1, 2, 3, 4, 5, 6, 7, stamps_ns=(9,) * 8)
    anew = ScriptedCamera(0, stamps_ns=(5,), then_wait=let_go)
    newest = NewestFrame(opener(stuck, anew), first_back_off_s=0.001, clock_ns=lambda: next(clock))
    assert anew.drained.wait(PATIENCE_S)
    assert stuck.closed.is_set()
    assert newest.health.reopened == 1
    assert taken(newest).stamp_ns == 5
    let_go.set()
    newest.close()


def test_a_recording_is_never_begun_anew() -> None:
    clock = count(0, 400_000_000)
    camera = ScriptedCamera(*range(20), stamps_ns=(9,) * 20)
    newest = NewestFrame(opener(camera), reopens=False, clock_ns=lambda: next(clock))
    newest.reopen("frozen")
    assert camera.closed.wait(PATIENCE_S)
    assert (newest.health.state, newest.health.bad) == ("ended", 19)
    newest.close()


def test_a_camera_can_be_opened_again_on_request(let_go: threading.Event) -> None:
    asked = threading.Event()

    class Frozen(ScriptedCamera):
        def read(self) -> Frame | None:
            asked.wait(PATIENCE_S)
            return super().read()

    frozen, after = Frozen(0, 1, 2), ScriptedCamera(0, then_wait=let_go)
    newest = NewestFrame(opener(frozen, after), first_back_off_s=0.001)
    newest.reopen("the image is frozen")
    asked.set()
    assert after.drained.wait(PATIENCE_S)
    assert frozen.closed.is_set()
    let_go.set()
    newest.close()


def test_a_read_that_takes_longer_than_the_camera_says_is_a_hang(let_go: threading.Event) -> None:
    now_ns = 0
    camera = ScriptedCamera(0, then_wait=let_go)
    newest = NewestFrame(opener(camera), clock_ns=lambda: now_ns)
    assert camera.drained.wait(PATIENCE_S)
    assert newest.hang(11_000_000_000) == ""
    assert newest.hang(11_000_000_001) == "reading"
    let_go.set()
    assert camera.closed.wait(PATIENCE_S)
    assert newest.hang(10**15) == ""  # it has ended
    newest.close()


def test_a_lost_camera_that_is_tried_again_does_not_hang() -> None:
    camera = ScriptedCamera(0, CameraLost("unplugged"))
    newest = NewestFrame(opener(camera), first_back_off_s=60.0, clock_ns=lambda: 0)
    assert camera.closed.wait(PATIENCE_S)
    newest.take(PATIENCE_S)
    deadline = threading.Event()
    while newest.hang(32_000_000_000) and not deadline.wait(0.001):
        pass
    assert newest.hang(60_000_000_000) == ""
    newest.close()


def test_a_clock_that_is_ahead_is_found_out_and_corrected(caplog: pytest.LogCaptureFixture) -> None:
    """Some drivers stamp the end of the next exposure: at 5 frames per second 200 ms ahead, and never otherwise."""
    now = count(10**9, 200_000_000)
    ahead_ns = [312_000_000 + jitter for jitter in (0, 9_000_000, 4_000_000, 0, 1_000_000, 2_000_000, 8_000_000)]
    times_ns = [next(now) for _ in ahead_ns]
    camera = ScriptedCamera(*range(7), stamps_ns=tuple(map(sum, zip(times_ns, ahead_ns, strict=True))))
    clock = {"read": -1}

    class Reading:
        differences, read_timeout_s = camera.differences, camera.read_timeout_s

        def read(self) -> Frame | None:
            clock["read"] += 1
            return camera.read()

        def close(self) -> None:
            camera.close()

    newest = NewestFrame(opener(Reading()), clock_ns=lambda: times_ns[max(0, min(clock["read"], 6))])
    assert camera.closed.wait(PATIENCE_S)
    frame = taken(newest)
    assert frame.index == 6
    assert frame.stamp_ns == times_ns[6] + ahead_ns[6] - max(ahead_ns[:5])
    assert (newest.health.delivered, newest.health.bad) == (3, 4)
    assert "timestamps: 321 ms ahead of this computer's clock, corrected" in newest.health.differences
    assert "321 ms ahead" in caplog.text


def test_timestamps_in_the_future_that_do_not_agree_are_no_clock() -> None:
    camera = ScriptedCamera(*range(8), stamps_ns=tuple(10**9 * (index + 1) for index in range(8)))
    newest = NewestFrame(opener(camera), clock_ns=lambda: 100)
    assert camera.closed.wait(PATIENCE_S)
    assert (newest.health.delivered, newest.health.bad) == (0, 8)
