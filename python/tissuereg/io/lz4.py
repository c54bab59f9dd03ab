"""Unpacking of LZ4 blocks, which VTK writes by default in newer versions; the format has no numbers beyond bytes."""

from tissuereg.errors import FormatError


def unpacked_lz4(block: bytes, size: int) -> bytes:
    """Return the content of one LZ4 block.

    `block`: packed bytes, without a frame round them; `size`: number of bytes that it holds. Raises `FormatError` if it
    holds another number, or is spoilt.
    """
    out, at, end = bytearray(), 0, len(block)
    try:
        while at < end:
            token = block[at]
            at += 1
            literals, at = _length(block, at, token >> 4)
            out += block[at : at + literals]
            at += literals
            if at >= end:
                break
            back = block[at] | block[at + 1] << 8
            at += 2
            length, at = _length(block, at, token & 15)
            length += 4
            start = len(out) - back
            if back == 0 or start < 0 or len(out) + length > size:
                break
            if back >= length:
                out += out[start : start + length]
            else:
                seed = bytes(out[start:])
                out += (seed * (length // back + 1))[:length]
    except IndexError:
        pass
    if len(out) != size or at != end:
        message = f"an LZ4 block must hold {size} bytes; it is spoilt after {len(out)}"
        raise FormatError(message)
    return bytes(out)


def _length(block: bytes, at: int, short: int) -> tuple[int, int]:
    """Return a length that begins with four bits, `short`, and goes on in bytes from `at`; and where these end."""
    more = 255 if short == 15 else 0
    while more == 255:
        more = block[at]
        at += 1
        short += more
    return short, at
