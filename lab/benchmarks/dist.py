"""Wheel and sdist of the last commit, byte for byte the same wherever they are built.

    python lab/benchmarks/dist.py [--out dist]

The commit is cloned into two folders of different names, built in each, one after the other, and the hashes are
compared. The wheel takes its times from SOURCE_DATE_EPOCH, the commit's time, and its permissions from the clone, which
is made for everybody to read. setuptools gives the sdist the times and the owner of the files: it is packed again
without them. `SHA256SUMS` is written beside the two files. Exit code 1 where the builds differ, 2 without git.
"""

from __future__ import annotations

import gzip
import hashlib
import io
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

from kit import asked

ROOT = Path(__file__).resolve().parents[2]
_FOLDER, _PROGRAM, _FILE = 0o755, 0o755, 0o644


def repacked(sdist: bytes, epoch: int) -> bytes:
    """Repack an sdist with sorted file names, one time stamp, no owner and plain permissions."""
    packed = io.BytesIO()
    with (
        tarfile.open(fileobj=io.BytesIO(sdist)) as old,
        gzip.GzipFile(fileobj=packed, mode="wb", filename="", mtime=epoch) as stream,
        tarfile.open(fileobj=stream, mode="w", format=tarfile.PAX_FORMAT) as new,
    ):
        for member in sorted(old.getmembers(), key=lambda m: m.name):
            clean = tarfile.TarInfo(member.name)
            clean.type, clean.linkname, clean.size, clean.mtime = member.type, member.linkname, member.size, epoch
            clean.mode = _FOLDER if member.isdir() else _PROGRAM if member.mode & 0o100 else _FILE
            new.addfile(clean, old.extractfile(member) if member.isfile() else None)
    return packed.getvalue()


def build(clone: Path, epoch: int) -> dict[str, bytes]:
    """Build sdist and wheel; return the name and content of each."""
    before = os.umask(0o022)
    try:
        subprocess.run(["git", "clone", "--quiet", ROOT, clone], check=True)
        settings = {**os.environ, "SOURCE_DATE_EPOCH": str(epoch)}
        done = subprocess.run(
            [sys.executable, "-m", "build", "."], cwd=clone, env=settings, capture_output=True, text=True, check=False
        )
    finally:
        os.umask(before)
    if done.returncode:
        raise SystemExit(done.stdout + done.stderr)
    files = {path.name: path.read_bytes() for path in sorted((clone / "dist").iterdir())}
    return {name: repacked(data, epoch) if name.endswith(".tar.gz") else data for name, data in files.items()}


def main() -> int:
    """Build twice, compare, write."""
    out = asked(__doc__, out={"type": Path, "default": ROOT / "dist", "metavar": "DIR"}).out
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        print("error: not a git checkout, expected one: what belongs to the commit is not known", file=sys.stderr)
        return 2
    epoch = int(subprocess.check_output(["git", "log", "-1", "--format=%ct"], cwd=ROOT, text=True))
    with tempfile.TemporaryDirectory() as folder:
        first = build(Path(folder, "one"), epoch)
        second = build(Path(folder, "the-other", "place"), epoch)
    sums = [{name: hashlib.sha256(data).hexdigest() for name, data in made.items()} for made in (first, second)]
    for name in sorted({*first, *second}):
        same = sums[0].get(name) == sums[1].get(name)
        print(f"{sums[0].get(name)}  {name}  {'the same twice' if same else f'DIFFERS: {sums[1].get(name)}'}")
    if sums[0] != sums[1]:
        return 1
    out.mkdir(parents=True, exist_ok=True)
    for name, data in first.items():
        (out / name).write_bytes(data)
    (out / "SHA256SUMS").write_text("".join(f"{digest}  {name}\n" for name, digest in sums[0].items()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
