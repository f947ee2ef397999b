"""Campaigns that are killed, damaged or out of space: the same bytes in the end,
nothing done twice.
"""

from __future__ import annotations

import contextlib
import os
import random
import resource
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fraclink as fl
from campaigns import computed, continued, parts_of, small
from fraclink import main
from fraclink.errors import FieldError, FileFormatError
from fraclink.trials import load_campaign, run_campaign, summarise


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """A finished campaign of three parts."""
    return computed(small(), tmp_path_factory.mktemp("whole"))


@pytest.fixture
def copy(whole, tmp_path) -> Path:
    folder = tmp_path / "copy"
    shutil.copytree(whole, folder)
    return folder


def identities(folder: Path) -> dict[str, tuple[int, int]]:
    """Inode and modification time of every part, which change when it is written again."""
    found = {}
    for path in folder.glob("part-*.npz"):
        about = path.stat()
        found[path.name] = (about.st_ino, about.st_mtime_ns)
    return found


Begin = Callable[[Path], subprocess.Popen[str]]


def kill_after(
    folder: Path, begin: Begin, delay: float, parts: int
) -> dict[str, tuple[int, int]]:
    """Start, wait for `parts` more parts and `delay` seconds, then kill the process and
    its workers.
    """
    there = len(identities(folder)) if folder.exists() else 0
    process = begin(folder)
    try:
        while len(identities(folder)) < there + parts and process.poll() is None:
            time.sleep(0.01)
        time.sleep(delay)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
    return identities(folder)


def killed(folder: Path, begin: Begin, kills: int) -> str:
    """Kill a campaign `kills` times at random and let it finish; no part may be
    computed twice. Returns its output.
    """
    rng = random.Random(4)  # noqa: S311
    kept: dict[str, tuple[int, int]] = {}
    for _ in range(kills):
        left = kill_after(folder, begin, rng.uniform(0.0, 0.3), rng.randrange(2))
        assert kept.items() <= left.items()
        kept = left
    process = begin(folder)
    out, err = process.communicate()
    assert process.returncode in (0, 1), err
    assert kept.items() <= identities(folder).items()
    assert not list(folder.glob(".*.tmp"))
    return out


@pytest.mark.slow
def test_killed_campaigns_resume_to_the_same_bytes(tmp_path):
    folder, campaign = tmp_path / "killed", small(4000)
    fl.save(campaign, folder / "campaign.json")
    killed(folder, continued, 2)
    assert parts_of(folder) == parts_of(computed(campaign, tmp_path / "alone"))


@pytest.mark.slow
def test_the_half_of_a_part_that_a_kill_left_is_cleaned_up(copy, whole):
    (copy / "part-0000001.npz").unlink()
    half = copy / ".part-0000001.npz.k9x_2a.tmp"  # as `atomic_write` names it
    half.write_bytes(b"PAR1")
    anothers = copy / ".notes.txt.tmp"
    anothers.write_text("not ours")
    run_campaign(small(), copy)
    assert not half.exists() and anothers.exists() and parts_of(copy) == parts_of(whole)


@pytest.mark.slow
def test_two_workers_write_the_bytes_of_one(whole, tmp_path):
    seen = []
    done = run_campaign(small(), tmp_path / "two", workers=2, watch=seen.append)
    assert parts_of(tmp_path / "two") == parts_of(whole) and len(parts_of(whole)) == 3
    assert (done.before, done.done, done.runs) == (0, 2500, 2500) and len(seen) == 3
    assert seen[-1].failed == summarise(tmp_path / "two").failure.count > 0


@pytest.mark.slow
def test_a_longer_campaign_goes_on(copy, whole, tmp_path):
    kept = identities(copy)
    longer = replace(small(), runs=3000)
    # the last part was half full and is repeated
    assert run_campaign(longer, copy).before == 2000
    assert {n: v for n, v in identities(copy).items() if n[5:12] < "0000002"} == {
        n: v for n, v in kept.items() if n[5:12] < "0000002"
    }
    assert load_campaign(copy).runs == 3000
    assert parts_of(copy) == parts_of(computed(longer, tmp_path / "new"))


@pytest.mark.slow
def test_an_interrupted_campaign_drops_what_waits(tmp_path, whole):
    def interrupt(_: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_campaign(small(9000), tmp_path / "parts", workers=2, watch=interrupt)
    assert 1 <= len(parts_of(tmp_path / "parts")) < 9
    assert run_campaign(small(9000), tmp_path / "parts").done == 9000


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-100])


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 3] ^= 0x10
    path.write_bytes(data)


def empty(path: Path) -> None:
    path.write_bytes(b"")


def take_anothers(path: Path) -> None:
    other = computed(replace(small(), runs=2000, seed=8), path.parent / "other")
    shutil.copy(other / path.name, path)
    shutil.rmtree(other)


def take_the_first(path: Path) -> None:
    shutil.copy(path.with_name("part-0000000.npz"), path)


def rewrite(path: Path) -> None:
    """Edit one number with a program that writes valid files, and keep the file's
    description of itself.
    """
    with np.load(path) as part:
        members = dict(part.items())
    (name,) = (each for each in members if each.endswith("settling_time"))
    members[name] = members[name] + 1e-9
    with path.open("wb") as stream:
        np.savez(stream, **members)


@pytest.mark.slow
@pytest.mark.parametrize("damage", [truncate, rewrite])
def test_a_report_says_which_runs_a_damaged_part_leaves_out(copy, damage, capsys):
    complete = summarise(copy)
    assert (complete.missing, complete.left_out) == (0, "")
    damage(copy / "part-0000001.npz")
    (copy / "part-0000002.npz").unlink()
    found = summarise(copy)
    assert found.missing == small().runs - small().part_runs(0) and not found.passed
    runs = f"{found.missing} of {small().runs} runs are left out"
    assert found.left_out.startswith(runs)
    assert main(["report", str(copy), "--out", str(copy / "report.html")]) == 1
    assert found.left_out[:60] in " ".join(capsys.readouterr().out.split())
    assert found.left_out in (copy / "report.html").read_text("utf-8")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_pipe_in_the_place_of_a_part_holds_nobody(tmp_path):
    fl.save(small(), tmp_path / "campaign.json")
    pipe = tmp_path / "part-0000000.npz"
    os.mkfifo(pipe)
    with ThreadPoolExecutor() as pool:
        reading = pool.submit(summarise, tmp_path)
        done, _ = wait((reading,), timeout=20)
        if not done:  # release it, or the test itself waits
            os.close(os.open(pipe, os.O_WRONLY | os.O_NONBLOCK))
        assert done and isinstance(reading.exception(), FieldError)


@pytest.mark.slow
@pytest.mark.parametrize(
    "damage", [truncate, flip, empty, take_anothers, take_the_first, rewrite]
)
def test_a_damaged_part_is_done_again(copy, whole, damage):
    kept = identities(copy)
    path = copy / "part-0000001.npz"
    damage(path)
    assert path.read_bytes() != (whole / path.name).read_bytes()
    assert run_campaign(small(), copy).before == 1500
    assert parts_of(copy) == parts_of(whole)
    others = {n: v for n, v in kept.items() if n != path.name}
    assert others.items() <= identities(copy).items()


@pytest.mark.slow
def test_every_flipped_byte_is_noticed(copy, whole):
    path = copy / "part-0000002.npz"
    good, wanted = path.read_bytes(), fl.load(path).columns
    rng = random.Random(5)  # noqa: S311
    # bytes of the whole file, and more of them from its end with the directory
    places = rng.sample(range(len(good)), 60) + rng.sample(
        range(len(good) - 4000, len(good)), 200
    )
    for at in places:
        data = bytearray(good)
        data[at] ^= 1 << rng.randrange(8)
        path.write_bytes(data)
        # A byte that no value depends on (such as a comment of the writer) may be
        # accepted; a changed number never.
        with contextlib.suppress(FileFormatError):
            found = fl.load(path).columns
            assert all((found[n] == wanted[n]).all() for n in wanted), at


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        ('"format": 3', '"format": 2', "format"),
        ('"format": 3', '"format": 99', "format"),
        ('"seed": 7', '"seed": 8', "sha256"),
        ('"runs": 2500', '"runs": "many"', "sha256"),
        ('"fraclink": "campaign"', '"fraclink": "plan"', "file"),
    ],
)
def test_other_formats_and_edited_campaigns_are_refused(copy, old, new, field, capsys):
    path = copy / "campaign.json"
    text = path.read_text("utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), "utf-8")
    kept = identities(copy)
    with pytest.raises(FieldError, match=field):
        load_campaign(copy)
    with pytest.raises(FieldError, match=field):
        run_campaign(small(), copy)
    assert main(["report", str(copy)]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert identities(copy) == kept


@pytest.mark.slow
def test_the_folder_of_another_campaign_is_refused(copy):
    with pytest.raises(FieldError, match="another campaign"):
        run_campaign(replace(small(), seed=8), copy)


def test_campaigns_read_back_equal(tmp_path):
    fl.save(small(), tmp_path / "campaign.json")
    back = load_campaign(tmp_path)
    assert back.fingerprint == small().fingerprint and back.draws == small().draws
    with pytest.raises(FileFormatError):
        load_campaign(tmp_path / "nothing")


@pytest.mark.parametrize("workers", [0, 2000, 1.5, True])
def test_impossible_workers_are_refused(tmp_path, workers):
    with pytest.raises(FieldError, match="workers"):
        run_campaign(small(), tmp_path, workers=workers)


@pytest.mark.slow
def test_no_room_for_a_part_keeps_the_finished_ones(copy, whole):
    """A file that may not grow fails as on a full disk: first with a short write, then
    with an error.
    """
    (copy / "part-0000001.npz").unlink()
    kept = identities(copy)
    campaign = load_campaign(copy)
    with (
        pytest.raises(FieldError, match="not writable") as caught,
        _files_up_to(20_000),
    ):
        run_campaign(campaign, copy, workers=1)
    assert "Finished parts are kept" in str(caught.value)
    assert identities(copy) == kept and not list(copy.glob(".*.tmp"))
    assert run_campaign(campaign, copy).before == 1500
    assert parts_of(copy) == parts_of(whole)


@contextlib.contextmanager
def _files_up_to(size: int):
    """Let this process write files of at most `size` bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)


@pytest.mark.slow
def test_a_full_disk_is_told(tmp_path, copy):
    if os.geteuid() != 0 or not shutil.which("mount"):
        pytest.skip("mounting a small disk needs root")
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(  # noqa: S603
        ["mount", "-t", "tmpfs", "-o", "size=600k", "tmpfs", str(disk)]  # noqa: S607
    )
    if mounted.returncode:
        pytest.skip("no right to mount a small disk")
    try:
        with pytest.raises(FieldError, match="No space left"):
            run_campaign(small(), disk)
        finished = parts_of(disk)
        assert finished and finished.items() <= parts_of(copy).items()
        assert not list(disk.glob(".*.tmp"))
    finally:
        subprocess.run(["umount", str(disk)], check=True)  # noqa: S603, S607


@pytest.mark.slow
def test_an_unwritable_folder_is_told(tmp_path):
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(FieldError, match="not a folder"):
        run_campaign(small(), tmp_path / "file")


def test_a_study_opens_whose_campaign_was_stopped_before_its_first_part(tmp_path):
    run_campaign(small(10), tmp_path / "arms")
    (part,) = (tmp_path / "arms").glob("part-*.npz")
    part.unlink()
    fl.Rig.named("paper-2023").save(tmp_path / "rig.toml")
    assert fl.trials.load_study(tmp_path).arms is None
