"""Pack the files of wheels anew, each in the way that makes it smallest; their content stays as it is.

    python tools/pack_wheel.py WHEEL ...

The tables of the shipped models are digits that hardly ever repeat: for those it is smaller not to look for what came
before, which builders of wheels always do.
"""

import argparse
import zipfile
import zlib
from pathlib import Path

LEVEL, MEMORY = 9, 9
STRATEGIES = (zlib.Z_DEFAULT_STRATEGY, zlib.Z_FILTERED, zlib.Z_RLE)


def packer(strategy: int) -> "zlib._Compress":
    """Return what packs bytes for a zip file."""
    return zlib.compressobj(LEVEL, zlib.DEFLATED, -zlib.MAX_WBITS, MEMORY, strategy)


def packed_size(content: bytes, strategy: int) -> int:
    """Return the number of bytes that content takes."""
    made = packer(strategy)
    return len(made.compress(content)) + len(made.flush())


def pack(wheel: Path) -> None:
    """Write a wheel anew, whole or not at all."""
    draft = wheel.with_suffix(".draft")
    with zipfile.ZipFile(wheel) as before, zipfile.ZipFile(draft, "w") as after:
        for entry in before.infolist():
            content = before.read(entry)
            new = zipfile.ZipInfo(entry.filename, entry.date_time)
            new.external_attr, new.compress_type = entry.external_attr, zipfile.ZIP_DEFLATED
            best = min(STRATEGIES, key=lambda strategy, content=content: packed_size(content, strategy))
            with after.open(new, "w") as stream:
                stream._compressor = packer(best)  # zipfile has no public word for a strategy
                stream.write(content)
    with zipfile.ZipFile(draft) as written:
        spoilt = written.testzip()
    if spoilt is not None:
        message = f"{spoilt} of {draft} must be what was packed; it is not"
        raise SystemExit(message)
    before_bytes = wheel.stat().st_size
    draft.replace(wheel)
    print(f"{wheel.name}: {before_bytes} bytes, packed anew {wheel.stat().st_size}")


def main() -> None:
    """Pack the wheels that are named."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("wheels", type=Path, nargs="+", metavar="WHEEL")
    for wheel in parser.parse_args().wheels:
        pack(wheel)


if __name__ == "__main__":
    main()
