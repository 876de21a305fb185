"""`make test CHANGED=1`: the test files of what has changed since a commit, one path a line.

A test file is run if it has changed, imports a changed file, or is in the folder of tests/ that belongs to it: that of
edge/localization/ is tests/localization/. Docs and systemd/ have folders of their own.

    python -m tests.changed [COMMIT]    COMMIT: by default where this branch left main; on main, the newest commit
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import PurePath

from tests.common import ROOT
from tests.imported import imports

ALWAYS = ("tests/test_import_rule.py",)


def main(arguments: list[str]) -> int:
    """Print the test files for the changes since `arguments[0]`, or since the branch left main."""
    changed = changed_since(arguments[0] if arguments else _git("merge-base", "HEAD", "main")[0])
    print(*files_to_run(changed), sep="\n")
    return 0


def changed_since(commit: str) -> list[PurePath]:
    """Files that differ from a commit, and those that git does not know yet, from the top of the checkout."""
    return [
        PurePath(name) for name in (*_git("diff", "--name-only", commit), *_git("ls-files", "-o", "--exclude-standard"))
    ]


def files_to_run(changed: list[PurePath]) -> list[str]:
    """The test files to run, sorted, as paths from the top of the checkout."""
    modules = {
        ".".join(path.with_suffix("").parts).removesuffix(".__init__") for path in changed if path.suffix == ".py"
    }
    folders = {folder for path in changed if (folder := folder_of(path)) is not None}
    found = set(ALWAYS)
    for file in (ROOT / "tests").rglob("test_*.py"):
        path = file.relative_to(ROOT)
        if path in changed or any(path.is_relative_to(one) for one in folders) or modules & imports(file):
            found.add(str(path))
    return sorted(found)


def folder_of(path: PurePath) -> PurePath | None:
    """The folder whose tests belong to a file, None where only importing it makes a test its own."""
    first, *rest = path.parts[:-1] or ("docs" if path.suffix == ".md" else "",)
    below: tuple[str, ...] | None = None
    if first == "edge" and rest:
        below = (rest[0],)
    elif first == "edge_plugins" and rest:
        below = ("plugins", rest[0])
    elif first == "sim" or first in ("docs", "systemd", "firmware_config"):
        below = (first, *rest)
    elif first == "tests" and (path.name == "conftest.py" or path.suffix != ".py"):
        below = tuple(rest[:1])
    return None if below is None else PurePath("tests", *below)


def _git(*arguments: str) -> list[str]:
    return subprocess.run(("git", *arguments), cwd=ROOT, check=True, capture_output=True, text=True).stdout.splitlines()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
