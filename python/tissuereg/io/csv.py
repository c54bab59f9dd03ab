"""Checked reading and writing of comma-separated tables; an error names the line of the fault."""

import csv
import io
import itertools
import math
import os
import re
import unicodedata
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from tissuereg.errors import FormatError
from tissuereg.io.atomic import atomic_file
from tissuereg.io.bounds import FILES, bounded_stream, existing_file

#: What spreadsheets write before the header to say how cells are parted.
_SEPARATOR = re.compile(r"\s*\"?sep=(.)\"?\s*", re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+(e[+-]?\d+)?", re.IGNORECASE)


def split_rows(lines: Iterable[str]) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and cells of each row that is not empty; the first is the header.

    `lines`: lines with their ends. Cells are parted by commas, tabs or semicolons, of which the header has most, and
    stripped of white space. Where it is not commas, numbers may have decimal commas, which become points. Raises
    `csv.Error` at a row that is no such text.

    >>> list(split_rows(["name;x_mm", "a;1,5"]))
    [(1, ['name', 'x_mm']), (2, ['a', '1.5'])]
    """
    left, header = iter(lines), ""
    begin: list[str] = []
    while not header.strip() and (header := next(left, None) or ""):
        begin.append(header)
    stated = _SEPARATOR.fullmatch(header)
    if stated:
        begin[-1] = "\n"
    delimiter = stated[1] if stated else max(",\t;", key=header.count)
    reader = csv.reader(itertools.chain(begin, left), delimiter=delimiter, skipinitialspace=True, strict=True)
    for row in reader:
        cells = [cell.strip() for cell in row]
        if delimiter != ",":
            cells = [cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell for cell in cells]
        if any(cells):
            yield reader.line_num, cells


@dataclass(frozen=True, slots=True)
class Row:
    """One line of a comma-separated table below its header.

    `file`: path of the table; `line`: number of the line, where the header has 1; `cells`: text of each cell by column,
    without white space around it.
    """

    file: Path
    line: int
    cells: dict[str, str]

    @property
    def where(self) -> str:
        """File and number of the line, as ``file:line``, for messages."""
        return f"{self.file}:{self.line}"

    def text(self, column: str) -> str:
        """Return the text in this column, in Unicode's form NFC; raise `FormatError` if the cell is empty."""
        if not self.cells[column]:
            message = f"column '{column}' must not be empty, at {self.file} line {self.line}"
            raise FormatError(message, where=self.where)
        return unicodedata.normalize("NFC", self.cells[column])

    def number(self, column: str, *, may_miss: bool = False) -> float:
        """Return the number in this column; it must be finite.

        `may_miss`: whether an empty cell, or the word ``nan``, is allowed and gives NaN. Raises `FormatError` if the
        cell holds no number, one that is not finite, or nothing where that is not allowed.
        """
        text = self.cells[column]
        if may_miss and text.lower() in ("", "nan"):
            return math.nan
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            wanted = "a finite number or empty" if may_miss else "a finite number"
            message = f"column '{column}' must hold {wanted}, got '{text}' at {self.file} line {self.line}"
            raise FormatError(message, where=self.where)
        return value

    def numbers(self, columns: Iterable[str], *, may_miss: bool = False) -> tuple[float, ...]:
        """Return the numbers in several columns, in their order; each must be finite.

        `columns`: names of the columns; `may_miss`: whether an empty cell, or the word ``nan``, is allowed and gives
        NaN. Raises `FormatError` as `number` does.
        """
        return tuple(self.number(column, may_miss=may_miss) for column in columns)


def read_table(
    path: str | os.PathLike[str], columns: Sequence[str], optional: Sequence[str] = (), *, most_rows: int | None = None
) -> list[Row]:
    """Return the rows of a comma-separated table with a header line, in file order; there is at least one.

    `path`: UTF-8 text, its cells parted as `split_rows` has it; empty lines are skipped; `columns`: columns that must
    be there, in any order; `optional`: columns that may be there; `most_rows`: largest number of rows; reading stops
    with an error at the next; None for any number. Raises `FormatError` if the file is missing, too large or too long,
    no text, has another header, a line of another length, or no row at all.
    """
    return list(table_rows(path, columns, optional, most_rows=most_rows))


def table_rows(
    path: str | os.PathLike[str],
    columns: Sequence[str],
    optional: Sequence[str] = (),
    *,
    most_rows: int | None = None,
    most_mb: int = FILES.table_mb,
) -> Iterator[Row]:
    """Yield the rows of a table as `read_table` returns them, one after another; `most_mb`: its largest size, MB.

    Raises as `read_table` does, once it comes to the fault.
    """
    file = existing_file(path, most_mb)
    try:
        with io.TextIOWrapper(bounded_stream(file, most_mb), encoding="utf-8-sig", newline="") as handle:
            yield from _rows(file, split_rows(handle), columns, optional, most_rows)
    except (UnicodeDecodeError, csv.Error, OSError) as error:
        message = f"{file} must be a table in comma-separated UTF-8 text; it cannot be read: {error}"
        raise FormatError(message, where=str(file)) from error


def _rows(
    file: Path,
    found: Iterable[tuple[int, list[str]]],
    columns: Sequence[str],
    optional: Sequence[str],
    most_rows: int | None,
) -> Iterator[Row]:
    """Yield the rows of a table from the number and cells of each line; stop with an error at a fault.

    `file`: the table, for messages; `columns`, `optional`: columns that must and that may be there; `most_rows`:
    largest number of rows; None for any number. Raises `FormatError` at the first invalid line, or if there is no row.
    """
    header: list[str] | None = None
    count = 0
    for number, cells in found:
        if header is None:
            header = cells
            _check_header(file, header, columns, optional)
        elif count == most_rows:
            message = f"{file} must hold at most {most_rows} rows; more follow at line {number}"
            raise FormatError(message, where=f"{file}:{number}")
        else:
            yield _row(file, number, header, cells)
            count += 1
    if header is None:
        _check_header(file, [], columns, optional)
    if not count:
        message = f"{file} must hold at least one row below its header"
        raise FormatError(message, where=str(file))


def write_table(path: str | os.PathLike[str], header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a comma-separated table with a header line, whole or not at all.

    `header`: names of the columns; `rows`: rows with one value per column; None, NaN and infinities become empty cells,
    floats keep nine significant digits.
    """
    with atomic_file(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as handle:
        writer = csv.writer(handle, lineterminator="\n")
        writer.writerow(header)
        writer.writerows([_cell(value) for value in row] for row in rows)


def _cell(value: object) -> object:
    if isinstance(value, float):
        return f"{value:.9g}" if math.isfinite(value) else ""
    return "" if value is None else value


def _check_header(file: Path, header: list[str], columns: Sequence[str], optional: Sequence[str]) -> None:
    missing = [name for name in columns if name not in header]
    unknown = [name for name in header if name not in (*columns, *optional)]
    repeated = [name for name in header if header.count(name) > 1]
    if missing or unknown or repeated:
        wanted = ",".join(columns) + "".join(f"[,{name}]" for name in optional)
        message = f"{file} must begin with the header {wanted}, got '{','.join(header)}' at line 1"
        raise FormatError(message, where=f"{file}:1")


def _row(file: Path, line: int, header: list[str], cells: list[str]) -> Row:
    if len(cells) != len(header):
        message = f"every row must have {len(header)} cells, got {len(cells)} at {file} line {line}"
        raise FormatError(message, where=f"{file}:{line}")
    return Row(file, line, dict(zip(header, cells, strict=True)))
