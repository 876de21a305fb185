"""Which tests `make test CHANGED=1` runs."""

from __future__ import annotations

from pathlib import PurePath

import pytest

from tests.changed import ALWAYS, files_to_run


@pytest.mark.parametrize(
    ("changed", "among", "not_among"),
    [
        ("edge/localization/bound.py", "tests/localization/test_integrity.py", "tests/camera/test_newest.py"),
        ("edge_plugins/page/page.html", "tests/plugins/page/test_server.py", "tests/plugins/doctor/test_doctor.py"),
        ("edge/geodesy.py", "tests/test_geodesy.py", "tests/test_backoff.py"),
        ("README.md", "tests/docs/test_docs.py", "tests/test_geodesy.py"),
        ("tests/golden/run/home/sent.txt", "tests/golden/test_recordings.py", "tests/test_geodesy.py"),
        ("tests/udp_port.py", "tests/test_one_frame.py", "tests/test_geodesy.py"),
        ("tests/conftest.py", "tests/localization/test_integrity.py", "tests/none.py"),
    ],
)
def test_by_folder_and_by_import(changed: str, among: str, not_among: str) -> None:
    found = files_to_run([PurePath(changed)])
    assert among in found
    assert not_among not in found


def test_rules_of_the_whole_house_are_always_checked() -> None:
    assert files_to_run([]) == [*ALWAYS]
