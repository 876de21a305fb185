"""Folders of maps of several vehicles: merged to the same bytes in any order, and sent as deltas."""

from __future__ import annotations

import hashlib
import io
import shutil
import tarfile
import tracemalloc
from itertools import permutations
from pathlib import Path

import pytest

from edge.__main__ import main
from edge.reference_map import open_map_set
from edge_plugins.layers.tally import TALLIES, read_tallies
from sim.maps.exchange import apply, merge, write_delta
from sim.maps.keys import make_key, sign_map
from sim.maps.learning import learn
from tests.plugins.layers.drives import MADE_S, Driven, build, count


def content(folder: Path) -> dict[str, str]:
    """Of each file of a folder a checksum of its bytes."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Folders of three vehicles: one drive in common, and one of one name in each, with counts of their own."""
    folder = tmp_path_factory.mktemp("fleet")
    for number, name in enumerate("abc"):
        shared, own = folder / name / "shared", folder / name / "monday"
        if number:
            shutil.copytree(folder / "a" / "shared", shared)
        else:
            build(shared, Driven(end=20))
        build(own, Driven(number + 1, end=20 + number, made_s=MADE_S + number))
        count(folder / name, "shared", range(5 + number), MADE_S + 10 + number)
    (folder / "b" / "shared" / "keep").touch()
    return [folder / name for name in "abc"]


def test_merging_gives_the_same_bytes_in_any_order_and_any_number_of_times(fleet: list[Path], tmp_path: Path) -> None:
    found = []
    for number, order in enumerate(list(permutations(fleet))[::2]):
        merge(order, tmp_path / f"{number}")
        found.append(content(tmp_path / f"{number}"))
    merge(fleet[:2], tmp_path / "two")
    merge([tmp_path / "two", fleet[2], fleet[0]], tmp_path / "again")
    merge([tmp_path / "again", tmp_path / "0", fleet[1]], tmp_path / "and again")
    found += [content(tmp_path / "again"), content(tmp_path / "and again")]
    assert all(one == found[0] for one in found)
    assert len(open_map_set(tmp_path / "0").maps) == 4
    (drive,) = [one for one in learn(tmp_path / "0").drives if one.path.name == "shared"]
    assert drive.recognized == 5 + 6 + 7
    assert drive.is_kept


def test_of_two_files_of_one_run_the_later_one_is_kept(fleet: list[Path], tmp_path: Path) -> None:
    for name, rows in (("early", 5), ("late", 15)):
        shutil.copytree(fleet[0] / "shared", tmp_path / name / "shared")
        count(tmp_path / name, "shared", range(rows), MADE_S)
    for order in permutations((tmp_path / "early", tmp_path / "late")):
        merge(order, tmp_path / order[0].name / "merged")
        (tally,) = read_tallies(tmp_path / order[0].name / "merged")
        assert sum(tally.maps.values()) == 15


def test_a_delta_brings_what_is_missing_and_no_more(
    fleet: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    vehicle, office = tmp_path / "vehicle", tmp_path / "office"
    shutil.copytree(fleet[0], vehicle)
    shutil.copytree(fleet[1], office)
    first, second, nothing = (tmp_path / f"{name}.tar.gz" for name in ("first", "second", "nothing"))
    assert main(["map", "delta", str(office), "--since", str(vehicle), "-o", str(first)]) == 0
    assert "drives: 1, files of counts: 1" in (out := capsys.readouterr().out)
    assert "MB for a km" in out
    assert main(["map", "apply", str(vehicle), str(first)]) == 0
    assert {one.recognized for one in learn(vehicle).drives} == {0, 11}
    assert len(open_map_set(vehicle).maps) == 3
    assert apply(vehicle, first) == 0, "once more changes nothing"
    build(office / "tuesday", Driven(7, end=30))
    assert write_delta(office, first, second).drives == 1
    assert write_delta(office, first, nothing).drives == 1
    assert second.read_bytes() == nothing.read_bytes(), "a transfer can be resumed"
    assert apply(vehicle, second) == 1
    assert write_delta(office, vehicle, nothing).drives == 0


def test_retired_drives_are_not_sent(tmp_path: Path) -> None:
    for number in range(3):
        build(tmp_path / "maps" / f"{number}", Driven(end=30, made_s=MADE_S + number))
    assert main(["map", "learn", str(tmp_path / "maps"), "--layers", "1"]) == 0
    assert write_delta(tmp_path / "maps", None, tmp_path / "delta").drives == 1


def test_a_drive_that_is_not_signed_as_asked_adds_nothing(
    fleet: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    public = make_key(tmp_path / "key")
    office = Path(shutil.copytree(fleet[1], tmp_path / "office"))
    sign_map(office / "shared", tmp_path / "key")
    write_delta(office, None, tmp_path / "delta")
    (tmp_path / "vehicle").mkdir()
    command = [
        "map",
        "apply",
        str(tmp_path / "vehicle"),
        str(tmp_path / "delta"),
        "--require-signature-by",
        str(public),
    ]
    assert main(command) == 78
    assert f"{tmp_path / 'delta'}: monday: not signed" in capsys.readouterr().err
    assert content(tmp_path / "vehicle") == {}
    sign_map(office / "monday", tmp_path / "key")
    write_delta(office, None, tmp_path / "delta")
    assert main(command) == 0
    assert len(open_map_set(tmp_path / "vehicle", require_signature_by=public).maps) == 2


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.999])
def test_a_delta_that_is_cut_off_adds_nothing(share: float, fleet: list[Path], tmp_path: Path) -> None:
    write_delta(fleet[1], None, tmp_path / "delta")
    data = (tmp_path / "delta").read_bytes()
    (tmp_path / "delta").write_bytes(data[: int(share * len(data))])
    vehicle = Path(shutil.copytree(fleet[0], tmp_path / "vehicle"))
    assert main(["map", "apply", str(vehicle), str(tmp_path / "delta")]) == 78
    assert content(vehicle) == content(fleet[0])


@pytest.mark.parametrize("name", ["../x", "/etc/x", "a/../../x", ".hidden/map.json", "a/b/c", f"{TALLIES}/run.json"])
def test_a_file_that_belongs_to_no_map_is_refused(
    name: str, fleet: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with tarfile.open(tmp_path / "delta", "w:gz") as tar:
        member = tarfile.TarInfo(name)
        member.size = 1
        tar.addfile(member, io.BytesIO(b"x"))
    vehicle = Path(shutil.copytree(fleet[0], tmp_path / "vehicle"))
    assert main(["map", "apply", str(vehicle), str(tmp_path / "delta")]) == 78
    assert Path(name).name in (err := capsys.readouterr().err)
    assert len(err.strip().splitlines()) == 1
    assert content(vehicle) == content(fleet[0])


def altered(delta: Path, members: dict[str, bytes]) -> None:
    """Replace or add files of a delta."""
    with tarfile.open(delta, "r:gz") as tar:
        found = {one.name: stream.read() for one in tar if (stream := tar.extractfile(one)) is not None}
    with tarfile.open(delta, "w:gz") as tar:
        for name, data in {**found, **members}.items():
            member = tarfile.TarInfo(name)
            member.size = len(data)
            tar.addfile(member, io.BytesIO(data))


@pytest.mark.parametrize(
    ("members", "message"),
    [
        ({"monday/descriptors.i8": bytes(1000)}, "monday: not signed"),
        ({"shared/descriptors.i8": bytes(1000)}, "shared/map.json: the files with it are not those"),
        ({"shared/more": b"x"}, "shared/map.json: the files with it are not those"),
        ({f"{TALLIES}/{MADE_S:.0f}.json": b" " * (5 << 20)}, "too large for counts"),
        ({"shared/descriptors.i8": bytes(64 << 20)}, "unpacks to over 10 times its size"),
        ({"y\nforged/map.json": b"x"}, "'y\\nforged/map.json' is no file"),
        ({"only/raw.f16": b"x"}, "only/map.json: missing"),
    ],
)
def test_what_is_wrong_is_found_before_a_delta_is_unpacked(
    members: dict[str, bytes], message: str, fleet: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A file of 13.7 MB unpacked to 3 GB before its signature was read."""
    public = make_key(tmp_path / "key")
    office = Path(shutil.copytree(fleet[1], tmp_path / "office"))
    sign_map(office / "shared", tmp_path / "key")
    write_delta(office, None, tmp_path / "delta")
    altered(tmp_path / "delta", members)
    (tmp_path / "vehicle").mkdir()
    asked = ["--require-signature-by", str(public)] if "signed" in message else []
    tracemalloc.start()
    assert main(["map", "apply", str(tmp_path / "vehicle"), str(tmp_path / "delta"), *asked]) == 78
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert message in (err := capsys.readouterr().err)
    assert len(err.splitlines()) == 1
    assert content(tmp_path / "vehicle") == {}
    assert peak_bytes < 32 << 20


def test_a_header_of_a_member_that_unpacks_to_much_does_not_take_the_memory(
    fleet: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with tarfile.open(tmp_path / "delta", "w:gz", format=tarfile.PAX_FORMAT) as tar:
        tar.addfile(tarfile.TarInfo("x" * (64 << 20)))
    vehicle = Path(shutil.copytree(fleet[0], tmp_path / "vehicle"))
    tracemalloc.start()
    assert main(["map", "apply", str(vehicle), str(tmp_path / "delta")]) == 78
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert "unpacks to over 10 times its size" in capsys.readouterr().err
    assert peak_bytes < 48 << 20


def test_bad_folders_are_named(fleet: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for command in (
        ["merge", str(fleet[0] / "shared"), "-o", str(tmp_path / "new")],
        ["merge", str(fleet[0]), "-o", str(fleet[1])],
        ["delta", str(fleet[0]), "--since", str(fleet[0] / "shared" / "map.json"), "-o", str(tmp_path / "new")],
        ["apply", str(tmp_path / "none"), str(tmp_path / "new")],
    ):
        assert main(["map", *command]) == 78, command
        assert len(capsys.readouterr().err.strip().splitlines()) == 1
        assert not (tmp_path / "new").exists()
