"""Seeded mutations of files: the n-th of a seed is the same on every machine."""

import re
import zlib

import numpy as np

NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
# What a number in a text is replaced by: beyond every limit, none at all, or of another kind.
NUMBERS = (
    b"0", b"-0.0", b"-1", b"1e-320", b"1e-12", b"1e12", b"1e308", b"-1e308", b"1e999", b"nan",
    b"-inf", b"9" * 400, b"2147483648", b"4294967296", b"18446744073709551616", b"0x10", b"1_000",
    b"1,5", b"", b"true", b"'", "١٢".encode(), b"1 2", b"--1",
)  # fmt: skip
# What is put anywhere: of the syntaxes that are read, of paths that lead out, of no encoding.
PIECES = (
    b"\0", b"\xff\xfe", b"\n", b"\t" * 50, b"<", b">", b"</", b"<!--", b"]]>", b"&amp;", b"&x;",
    b'"', b"'", b"{", b"}", b"[", b"]", b"* ", b"$(", b"${", b"%s", b"/etc/shadow",
    b"../../../../etc/passwd",
    b"file:///etc/passwd", b"http://127.0.0.1:1/x", b"package://bullet_lab/../../etc/passwd",
    b"model://../../etc", b"~/.ssh/id_rsa", b"A" * 5000, b"<a>" * 300, b"[" * 300, "𝔘é".encode(),
)  # fmt: skip
MOST_CHANGES = 4


def generator(seed, way, number):
    """Return the random numbers of one mutant."""
    return np.random.default_rng([seed, zlib.crc32(way.encode()), number])


def mutant(seeds, random):
    """Return one of some inputs with one to four changes; another of them may be spliced in."""
    data = seeds[random.integers(len(seeds))]
    for _ in range(random.integers(1, MOST_CHANGES + 1)):
        change = CHANGES[random.integers(len(CHANGES))]
        data = change(data, seeds, random)
    return data


def _span(data, random, longest=200):
    start = int(random.integers(len(data) + 1))
    return slice(start, start + int(random.integers(longest)))


def _replaced(data, where, piece):
    return data[: where.start] + piece + data[where.stop :]


def _number(data, _seeds, random):
    found = list(NUMBER.finditer(data))
    if not found:
        return data
    match = found[random.integers(len(found))]
    return _replaced(data, slice(*match.span()), NUMBERS[random.integers(len(NUMBERS))])


def _piece(data, _seeds, random):
    piece = PIECES[random.integers(len(PIECES))]
    where = _span(data, random, 12) if random.random() < 0.5 else _span(data, random, 1)
    return _replaced(data, where, piece)


def _bits(data, _seeds, random):
    changed = bytearray(data)
    for _ in range(random.integers(1, 9)):
        if changed:
            changed[random.integers(len(changed))] ^= 1 << int(random.integers(8))
    return bytes(changed)


def _cut(data, _seeds, random):
    return data[: random.integers(len(data) + 1)]


def _left_out(data, _seeds, random):
    return _replaced(data, _span(data, random), b"")


def _twice(data, _seeds, random):
    where = _span(data, random, 600)
    return _replaced(data, slice(where.start, where.start), data[where])


def _line_moved(data, _seeds, random):
    lines = data.split(b"\n")
    first, second = random.integers(len(lines), size=2)
    lines[first], lines[second] = lines[second], lines[first]
    return b"\n".join(lines)


def _spliced(data, seeds, random):
    other = seeds[random.integers(len(seeds))]
    return _replaced(data, _span(data, random), other[_span(other, random, 600)])


# Numbers are where most of the meaning is.
CHANGES = (_number, _number, _number, _piece, _bits, _cut, _left_out, _twice, _line_moved, _spliced)
